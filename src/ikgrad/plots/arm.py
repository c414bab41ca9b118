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


def draw_floor(axes: Any, everything: np.ndarray, meshes: Sequence[Mesh], *, margin: float = 0.25) -> None:
    """Equal scales, a plain floor at z = 0 with the first arm's shadow, no walls, and so many metres around it all."""
    from matplotlib.ticker import MultipleLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    low, high = everything.min(axis=0) - margin, everything.max(axis=0) + margin
    low[2] = min(0.0, everything[:, 2].min())
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.38)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MultipleLocator(0.5))
        axis.set_pane_color((1, 1, 1, 0))
        axis.line.set_color("#BBBBBB")
        axis._axinfo["grid"].update(color="#E8E8E8", linewidth=0.6)  # no public way to colour 3-D grids
    dark = Poly3DCollection(shadow(meshes[0].faces, low[2]), facecolors="#DDDDDD", edgecolors="none", zorder=1)
    axes.add_collection3d(dark)
