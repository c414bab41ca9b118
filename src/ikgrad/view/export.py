"""A page as a file, for somebody who has nothing installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ikgrad.collision import Spheres
from ikgrad.errors import DataError
from ikgrad.files.places import check_output, in_one_move
from ikgrad.view.contest import Contest
from ikgrad.view.meshes import Look
from ikgrad.view.motion import FILM, Motion, thinned
from ikgrad.view.race import Run, iterations_to_show
from ikgrad.view.scene import SKY, ArmNodes, Place, add_axes, add_floor, add_path, add_spheres, camera
from ikgrad.view.server import start_server, stop_server
from ikgrad.view.session import Session

PICTURES = 30  # a second, of a motion
ITERATIONS = 15  # a second, of a race


def export_page(
    path: str | Path,
    session: Session,
    *,
    motion: Motion | None = None,
    spheres: Spheres | None = None,
    look: Look | None = None,
    force: bool = False,
) -> Path:
    """Write a page that needs no server and no network: the arm with all solutions of its pose, or in motion.

    Args:
        path: ``.html``.
        session: the arm.
        motion: joints to play, 30 rows a second, thinned out to 900 pictures.
        spheres: obstacles.
        look: the arm's own meshes.
        force: overwrite an existing file.

    Raises:
        MissingExtraError: viser is not installed.
        DataError: it cannot be written.
    """
    path = check_output(path, (".html",), force=force)
    text = page_html(session, motion=motion, spheres=spheres, look=look)
    try:
        with in_one_move(path, force=force) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot write the page: {error.strerror or error}") from error
    return path


def page_html(
    session: Session,
    *,
    motion: Motion | None = None,
    spheres: Spheres | None = None,
    look: Look | None = None,
    runs: Sequence[Run] = (),
    ghosts: bool = True,
    view: tuple[Place, Place] | None = None,
) -> str:
    """The page of `export_page` as text.

    Args:
        session: the arm.
        motion: joints to play.
        spheres: obstacles.
        look: the arm's own meshes.
        runs: of a race for the session's target, to be played instead.
        ghosts: with the other solutions.
        view: where to stand and where to look [m].

    Raises:
        ConfigError: viser is not installed.
    """
    server = start_server(port=0)  # a scene of its own: the page that is open must not see the film being made
    try:
        add_floor(server, session.robot)
        stand, look_at = view or camera(session.robot.length, arms=max(len(runs), 1))
        server.initial_camera.position, server.initial_camera.look_at = stand, look_at
        if runs:
            return _race(server, session, runs)
        if spheres is not None:
            add_spheres(server, spheres)
        arm = ArmNodes(server, session.robot, "/arm", look=look)
        return _pose(server, session, arm, ghosts) if motion is None else _film(server, session, arm, motion)
    finally:
        stop_server(server)


def _pose(server: Any, session: Session, arm: ArmNodes, ghosts: bool) -> str:
    arm.show(session.poses(session.q))
    add_axes(server, "/target", session.T_target, 0.15 * session.robot.length)
    others = session.solutions() if ghosts else session.q[None, :][:0]
    for k, q in enumerate(others):
        if bool((q - session.q).abs().max() > 1e-3):
            ArmNodes(server, session.robot, f"/ghosts/{k}", colour=SKY, opacity=0.22).show(session.poses(q))
    return str(server.get_scene_serializer().as_html())


def _film(server: Any, session: Session, arm: ArmNodes, motion: Motion) -> str:
    add_path(server, motion.tool_path(session.robot))
    recording = server.get_scene_serializer()
    for q in motion.q[thinned(len(motion.q), FILM)]:
        arm.show(session.poses(q))
        recording.insert_sleep(1 / PICTURES)
    return str(recording.as_html())


def _race(server: Any, session: Session, runs: Sequence[Run]) -> str:
    contest = Contest(server, session.robot, runs, session.T_target)
    recording = server.get_scene_serializer()
    for iteration in iterations_to_show(runs):
        contest.show(iteration)
        recording.insert_sleep(1 / ITERATIONS)
    return str(recording.as_html())


__all__ = ["export_page", "page_html"]
