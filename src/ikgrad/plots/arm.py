"""A robot arm in space, on its way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.kinematics import link_poses
from ikgrad.plots.style import INK, PALETTE, new_figure, styled
from ikgrad.plots.tubes import Mesh, arm_mesh, shadow
from ikgrad.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


AXIS_COLOURS = (PALETTE[1], PALETTE[2], PALETTE[0])  # x, y, z


def arm_path(
    robot: Robot,
    poses: Sequence[Tensor],
    *,
    paths: Mapping[str, np.ndarray] | None = None,
    points: Mapping[str, np.ndarray] | None = None,
    view: tuple[float, float] = (20.0, -50.0),
    radius: float = 0.075,
    legend: str = "tool on motion",
) -> Figure:
    """An arm in space: the first pose solid, the others as ghosts, with curves of the tool and named points.

    Args:
        robot: the robot, n joint variables.
        poses: joint values (n,) [rad or m].
        paths: name to (k, 3) positions [m].
        points: name to (3,) positions [m].
        view: elevation and azimuth of the camera [deg].
        radius: of the thickest link [m].
        legend: its title.
    """
    from matplotlib.patheffects import withStroke

    with styled():
        figure = new_figure((8.0, 6.0))
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        joints = [link_poses(robot, torch.as_tensor(q))[:, :3, 3].numpy() for q in poses]
        meshes = [arm_mesh(xyz, radius, skip=None if k == 0 else joints[0]) for k, xyz in enumerate(joints)]
        everything = np.concatenate([*joints, *(np.atleast_2d(p) for p in (paths or {}).values())])
        draw_floor(axes, everything, meshes)
        draw_meshes(axes, meshes)
        for colour, (name, xyz) in zip(PALETTE, (paths or {}).items(), strict=False):
            axes.plot(*xyz.T, color="white", linewidth=4.0, zorder=5)
            axes.plot(*xyz.T, color=colour, linewidth=2.2, zorder=6, label=name)
        for name, xyz in (points or {}).items():
            axes.plot(*xyz[:, None], "o", color=INK, markersize=7, markeredgecolor="white", zorder=8)
            label = axes.text(xyz[0], xyz[1], xyz[2] + 0.07, name, zorder=9, ha="center", fontsize=13)
            label.set_path_effects([withStroke(linewidth=3, foreground="white")])
        axes.view_init(*view)
        if paths:
            axes.legend(title=legend, loc="upper left", bbox_to_anchor=(0.0, 1.0), labelspacing=0.25)
    return figure


def arm_frames(
    robot: Robot,
    q: Tensor,
    *,
    targets: Tensor | None = None,
    view: tuple[float, float] = (20.0, -50.0),
    title: str = "",
) -> Figure:
    """An arm in space with the frames of its base, its joints and its tip; perhaps with frames that it should reach.

    Args:
        robot: the robot, n joint variables.
        q: (n,) [rad or m], or (P, n): the first pose solid, the others as ghosts.
        targets: (K, 4, 4) frames drawn broad [m].
        view: elevation and azimuth of the camera [deg].
        title: above the figure.

    Example:
        >>> import ikgrad as ik
        >>> arm_frames(ik.load_robot("arm4"), torch.zeros(4)).axes[0].get_zlabel()
        'z [m]'
    """
    q = torch.atleast_2d(torch.as_tensor(q)).double()
    with styled():
        figure = new_figure((8.0, 6.4))
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        links = [link_poses(robot.detach(), row).numpy() for row in q]
        every = np.concatenate([T[:, :3, 3] for T in links])
        size = 0.12 * float(np.ptp(every, axis=0).max() or 1.0)
        goals = np.empty((0, 4, 4)) if targets is None else targets.double().numpy()
        meshes = [
            arm_mesh(T[:, :3, 3], 0.25 * size, skip=links[0][:, :3, 3] if k else None) for k, T in enumerate(links)
        ]
        draw_floor(axes, np.concatenate([every, goals[:, :3, 3]]), meshes, margin=1.4 * size)
        draw_meshes(axes, meshes)
        for k, T in enumerate(links[0]):
            ends = k in (0, len(links[0]) - 1)
            draw_frame(axes, T, size if ends else 0.8 * size, width=3.0 if ends else 2.0)
        for T in goals:
            draw_frame(axes, T, size, width=3.0)
        frame_key(axes)
        axes.view_init(*view)
        figure.suptitle(title, fontsize=12)
    return figure


def draw_frame(axes: Any, T: np.ndarray, size: float, *, width: float, alpha: float = 1.0) -> None:
    """The three axes of a frame.

    Args:
        axes: three-dimensional.
        T: (4, 4) [m].
        size: length of the axes [m].
        width: of their lines [points].
        alpha: their opacity.
    """
    for k, colour in enumerate(AXIS_COLOURS):
        ray = np.stack([T[:3, 3], T[:3, 3] + size * T[:3, k]])
        axes.plot(*ray.T, color=colour, linewidth=width, alpha=alpha, zorder=7, solid_capstyle="round")


def frame_key(axes: Any) -> None:
    """The legend of frames."""
    for colour, name in zip(AXIS_COLOURS, "xyz", strict=True):
        axes.plot([], [], color=colour, linewidth=3, label=f"{name} axis")
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.95))


def draw_meshes(axes: Any, meshes: Sequence[Mesh]) -> None:
    """All arms as one collection, so that their faces are sorted by depth among each other."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    faces, colours = [], []
    for k, mesh in enumerate(meshes):
        shade = mesh.shade[:, None]
        rgb = np.where(mesh.joint[:, None], (0.22, 0.24, 0.28), (0.95, 0.45, 0.10)) * shade
        if k:  # ghosts: pale and translucent
            rgb = 0.6 * rgb + 0.4
        alpha = np.full((len(shade), 1), 1.0 if k == 0 else 0.28)
        faces.append(mesh.faces)
        colours.append(np.concatenate([rgb.clip(0, 1), alpha], axis=1))
    rgba = np.concatenate(colours)
    edges = rgba * [1, 1, 1, 0]
    edges[: len(faces[0])] = rgba[: len(faces[0])]  # close the hairlines between the solid arm's faces
    every = Poly3DCollection(np.concatenate(faces), facecolors=rgba, edgecolors=edges, linewidths=0.4, zorder=4)
    axes.add_collection3d(every)


def draw_floor(
    axes: Any, everything: np.ndarray, meshes: Sequence[Mesh], *, margin: float = 0.25, zoom: float = 1.0
) -> None:
    """Equal scales, a plain floor at z = 0 with the first arm's shadow, no walls, and so many metres around it all."""
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    low, high = everything.min(axis=0) - margin, everything.max(axis=0) + margin
    low[2] = min(0.0, everything[:, 2].min())
    lacking = np.maximum(0.6 * (high - low).max() - (high - low), 0.0) / 2  # on a narrow side the labels find no room
    low[:2], high[:2] = low[:2] - lacking[:2], high[:2] + lacking[:2]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=zoom)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    shares = (high - low) / (high - low).max()
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shares, strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(5 * share)), steps=[1, 2, 5, 10]))
        axis.set_pane_color((1, 1, 1, 0))
        axis.line.set_color("#BBBBBB")
        axis._axinfo["grid"].update(color="#E8E8E8", linewidth=0.6)  # no public way to colour 3-D grids
    if not meshes:
        return
    dark = Poly3DCollection(shadow(meshes[0].faces, low[2]), facecolors="#DDDDDD", edgecolors="none", zorder=1)
    axes.add_collection3d(dark)
