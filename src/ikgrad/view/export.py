"""A page as a file, for somebody who has nothing installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ikgrad.collision import Spheres
from ikgrad.errors import DataError
from ikgrad.files.places import check_output, in_one_move
from ikgrad.view.motion import FILM, Motion, thinned
from ikgrad.view.scene import SKY, ArmNodes, add_axes, add_floor, add_path, add_spheres
from ikgrad.view.server import start_server, stop_server
from ikgrad.view.session import Session

PICTURES = 30  # a second


def export_page(
    path: str | Path,
    session: Session,
    *,
    motion: Motion | None = None,
    spheres: Spheres | None = None,
    force: bool = False,
) -> Path:
    """Write a page that needs no server and no network: the arm with all solutions of its pose, or in motion.

    Args:
        path: ``.html``.
        session: the arm.
        motion: joints to play, 30 rows a second, thinned out to 900 pictures.
        spheres: obstacles.
        force: overwrite an existing file.

    Raises:
        MissingExtraError: viser is not installed.
        DataError: it cannot be written.
    """
    path = check_output(path, (".html",), force=force)
    server = start_server(port=0)
    try:
        text = _page(server, session, motion, spheres)
    finally:
        stop_server(server)
    try:
        with in_one_move(path, force=force) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot write the page: {error.strerror or error}") from error
    return path


def _page(server: Any, session: Session, motion: Motion | None, spheres: Spheres | None) -> str:
    robot = session.robot
    add_floor(server, robot)
    if spheres is not None:
        add_spheres(server, spheres)
    arm = ArmNodes(server, robot, "/arm")
    if motion is None:
        arm.show(session.poses(session.q))
        add_axes(server, "/target", session.T_target, 0.15 * robot.length)
        for k, q in enumerate(session.solutions()):
            if bool((q - session.q).abs().max() > 1e-3):
                ArmNodes(server, robot, f"/ghosts/{k}", colour=SKY, opacity=0.22).show(session.poses(q))
        return str(server.get_scene_serializer().as_html())
    add_path(server, motion.tool_path(robot))
    recording = server.get_scene_serializer()
    for q in motion.q[thinned(len(motion.q), FILM)]:
        arm.show(session.poses(q))
        recording.insert_sleep(1 / PICTURES)
    return str(recording.as_html())


__all__ = ["export_page"]
