"""What stands in the page's scene: arms, spheres, lines. Servers and handles are viser's."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.plots.style import PALETTE
from ikgrad.robot import Robot
from ikgrad.rotations import quat_wxyz_from_matrix
from ikgrad.view.meshes import Look
from ikgrad.view.shapes import Part, Triangles, arm_parts, base_mesh, link_radius, merge, part_mesh

Colour = tuple[int, int, int]
Place = tuple[float, float, float]


def rgb(colour: str) -> Colour:
    """``#0072B2`` as three bytes."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


BLUE, VERMILLION, GREEN, PINK, AMBER, SKY, INK = (rgb(colour) for colour in PALETTE)
ARM, MISSED, DARK, STEEL = (242, 115, 26), (165, 165, 165), (56, 61, 71), (150, 155, 165)

SLIM = 0.94  # radii of a translucent arm, as a share
FIELD_OF_VIEW = 0.85  # rad


class ArmNodes:
    """One arm in the scene.

    Args:
        server: viser's server.
        robot: the robot.
        root: name of the node that all others hang below.
        colour: of the links.
        opacity: None: solid; else a little slimmer, so that it vanishes inside a solid arm in the same place.
        place: of the base in the scene [m].
        visible: at first.
        look: the arm's own meshes; ``colour`` is then that of the links that have none.
    """

    def __init__(
        self,
        server: Any,
        robot: Robot,
        root: str,
        *,
        colour: Colour = ARM,
        opacity: float | None = None,
        place: Place = (0.0, 0.0, 0.0),
        visible: bool = True,
        look: Look | None = None,
    ):
        self._scene, self._name, self._missed = server.scene, root, False
        self._root = server.scene.add_frame(root, show_axes=False, position=place, visible=visible)
        self._frames: dict[int, Any] = {}
        self._painted: list[tuple[Any, Colour]] = []  # nodes that turn grey, and their own colours
        self._options = dict(opacity=opacity, cast_shadow=opacity is None, receive_shadow=opacity is None)
        thick = 1.0 if opacity is None else SLIM
        parts_here = tuple(part._replace(radius=thick * part.radius) for part in parts_to_draw(robot, look))
        for link, role, parts in _grouped(parts_here):
            tint = {"link": colour, "joint": DARK, "rail": STEEL}[role]
            node = self._add(link, role, merge_parts(parts), tint)
            if role == "link":
                self._painted.append((node, tint))
        for k, visual in enumerate(look.visuals if look else ()):
            self._painted.append((self._add(visual.link, f"mesh {k}", visual.mesh, visual.colour), visual.colour))
        if opacity is None and look is None:
            foot = base_mesh(link_radius(robot))
            self._scene.add_mesh_simple(f"{root}/foot", foot.vertices, foot.faces, color=DARK, **self._options)

    def _add(self, link: int, name: str, mesh: Triangles, colour: Colour) -> Any:
        """A mesh that moves with a link."""
        frame = f"{self._name}/{link}"
        if link not in self._frames:
            self._frames[link] = self._scene.add_frame(frame, show_axes=False)
        return self._scene.add_mesh_simple(f"{frame}/{name}", mesh.vertices, mesh.faces, color=colour, **self._options)

    def show(self, poses: Tensor) -> None:
        """Move the arm: (links, 4, 4) of `ikgrad.link_poses`."""
        quaternions, places = quat_wxyz_from_matrix(poses[:, :3, :3]).numpy(), poses[:, :3, 3].numpy()
        for link, frame in self._frames.items():
            frame.wxyz, frame.position = quaternions[link], places[link]

    def show_missed(self, missed: bool) -> None:
        """Grey, or its own colours."""
        if missed != self._missed:
            self._missed = missed
            for node, colour in self._painted:
                node.color = MISSED if missed else colour

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        if self._root.visible != visible:
            self._root.visible = visible

    def remove(self) -> None:
        """Take it out of the scene."""
        self._root.remove()


def parts_to_draw(robot: Robot, look: Look | None) -> tuple[Part, ...]:
    """Capsules and cylinders: all of them, or those that stand for meshes that could not be read."""
    parts = arm_parts(robot)
    if look is None:
        return parts
    frames = robot.detach().tables().link_frame  # parts belong to the first link of a frame, meshes to any
    without = {int(frames[link]) for link in look.missing}
    return tuple(part for part in parts if int(frames[part.link]) in without)


def _grouped(parts: tuple[Part, ...]) -> list[tuple[int, str, list[Part]]]:
    """Parts that make one mesh: those of one link and one role."""
    groups: dict[tuple[int, str], list[Part]] = {}
    for part in parts:
        groups.setdefault((part.link, part.role), []).append(part)
    return [(link, role, members) for (link, role), members in groups.items()]


def merge_parts(parts: list[Part]) -> Triangles:
    """Parts of one link as one mesh."""
    meshes = [part_mesh(part) for part in parts]
    return meshes[0] if len(meshes) == 1 else merge(meshes, turn=False)


def add_floor(server: Any, robot: Robot) -> None:
    """A grid at z = 0 (thick lines 0.5 m apart for an arm of a metre), and a camera that sees the whole arm."""
    size = robot.length
    cell = 0.5 * 10.0 ** np.round(np.log10(size))
    wide = cell * np.ceil(4 * size / cell)
    server.scene.add_grid(
        "/floor",
        width=wide,
        height=wide,
        cell_size=cell / 5,
        section_size=cell,
        cell_color=(228, 228, 228),
        section_color=(200, 200, 200),
    )
    server.initial_camera.position, server.initial_camera.look_at = camera(size)
    server.initial_camera.fov = FIELD_OF_VIEW


def camera(size: float, *, arms: int = 1) -> tuple[Place, Place]:
    """Where to stand and where to look; the controls cover the right third, so the arm stands left of the middle.

    Args:
        size: length of an arm [m].
        arms: how many there are; several stand in two rows.
    """
    if arms == 1:
        return (1.3 * size, -0.97 * size, 0.85 * size), (0.19 * size, 0.22 * size, 0.34 * size)
    return (0.35 * size, -2.5 * size, 1.55 * size), (0.42 * size, 0.0, 0.15 * size)


def add_spheres(server: Any, spheres: Spheres) -> list[Any]:
    """Obstacles; their handles in order."""
    balls = []
    for k, (centre, radius) in enumerate(zip(spheres.centers.numpy(), spheres.radii.tolist(), strict=True)):
        name = f"/obstacles/{k + 1}"
        balls.append(server.scene.add_icosphere(name, radius=radius, position=centre, color=BLUE, opacity=0.55))
    return balls


def add_path(server: Any, points: Tensor, *, name: str = "/path", colour: Colour = BLUE) -> Any:
    """A line through (k, 3) points [m]; a single point makes a short one."""
    points = torch.cat([points, points]) if len(points) == 1 else points
    ends = torch.stack([points[:-1], points[1:]], dim=1).numpy().astype(np.float32)
    return server.scene.add_line_segments(name, ends, colors=colour, thickness=2.5, thickness_units="screen")


def add_axes(server: Any, name: str, T: Tensor, size: float) -> Any:
    """The axes of a pose (4, 4)."""
    wxyz = quat_wxyz_from_matrix(T[:3, :3]).numpy()
    position = T[:3, 3].numpy()
    return server.scene.add_frame(name, axes_length=size, axes_radius=0.05 * size, wxyz=wxyz, position=position)


__all__ = ["ArmNodes", "add_axes", "add_floor", "add_path", "add_spheres", "camera", "rgb"]
