"""Figures: one style, one function per kind of picture; plain arrays in, a matplotlib ``Figure`` out.

No pyplot, no display, no global state: figures are drawn by Agg or written as SVG by `save_figure`. Colours are Okabe
and Ito's, which people with any colour vision can tell apart; every axis names its unit.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.kinematics import link_poses
from ikgrad.robot import Robot
from ikgrad.tubes import Mesh, arm_mesh, shadow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#333333")
INK, FAINT = "#333333", "#999999"
SUFFIXES = (".png", ".svg")
ERROR_LABEL = "E [m$^2$ + 1]"  # squares of three coordinates and of nine rotation entries, which have no unit

STYLE: Any = {
    "font.size": 11.0,
    "axes.titlesize": 12.0,
    "axes.labelsize": 11.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.8,
    "lines.linewidth": 2.0,
    "legend.frameon": False,
    "legend.fontsize": 10.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "ikgrad",
}


def convergence(
    curves: Mapping[str, np.ndarray], *, threshold: float, printed: Mapping[str, int] | None = None
) -> Figure:
    """Error against iteration, one small panel per run, on a logarithmic axis.

    Args:
        curves: name to (k,) values of E.
        threshold: E0, drawn as a line.
        printed: iterations that the paper prints, drawn as a ring for comparison.
    """
    with _style():
        figure, panels = _grid(len(curves), size=(10.0, 4.9))
        longest = max(len(curve) for curve in curves.values())
        for axes, (name, curve) in zip(panels, curves.items(), strict=False):
            steps = np.arange(1, len(curve) + 1)
            axes.semilogy(steps, curve, color=PALETTE[0])
            axes.axhline(threshold, color=FAINT, linewidth=1.2, linestyle="--")
            axes.plot(len(curve), curve[-1], "o", color=PALETTE[0], markersize=6)
            text = f"{len(curve)}"
            if printed and name in printed:
                axes.plot(printed[name], threshold, "o", markersize=13, fillstyle="none", color=PALETTE[1])
                text = f"{len(curve)}  (paper {printed[name]})"
            axes.text(0.97, 0.93, text, transform=axes.transAxes, ha="right", va="top", fontsize=10)
            axes.set_title(f"motion {name}", loc="left")
            axes.set(xlim=(0, longest * 1.06), ylim=(threshold / 8, 40), yticks=[1e-9, 1e-6, 1e-3, 1])
        _outer_labels(panels[: len(curves)], "iteration", ERROR_LABEL)
        _key(panels[len(curves)] if len(panels) > len(curves) else panels[0], threshold, bool(printed))
    return figure


def learning_rates(
    curves: Mapping[float, np.ndarray],
    finals: Mapping[float, np.ndarray],
    *,
    threshold: float,
    limit: int,
    title: str = "",
) -> Figure:
    """What the learning rate does: curves of one run, and the error that is left after so many iterations.

    Args:
        curves: learning rate to (k,) values of E, of one run.
        finals: learning rate to the values of E left after ``limit`` iterations, one per run.
        threshold: E0, drawn as a line.
        limit: iterations shown, the paper's I0.
        title: of the left panel.
    """
    with _style():
        figure = _figure((10.0, 4.2))
        left, right = figure.subplots(1, 2, sharey=True)
        for colour, (rate, curve) in zip(PALETTE, curves.items(), strict=False):
            shown = curve[:limit]
            left.semilogy(np.arange(1, len(shown) + 1), shown, color=colour, linewidth=1.6)
            left.plot(len(shown), shown[-1], "o", color=colour, markersize=5)
            for k, value in enumerate(np.sort(finals[rate])):
                right.plot(
                    rate * 1.05 ** (k - (len(finals[rate]) - 1) / 2),
                    value,
                    "o",
                    color=colour,
                    markersize=7,
                    markeredgecolor="white",
                )
            left.plot([], [], color=colour, label=f"{rate:g}")
        for axes in (left, right):
            axes.axhline(threshold, color=FAINT, linewidth=1.2, linestyle="--")
        left.set(xlabel="iteration", ylabel=ERROR_LABEL, title=title, xlim=(0, limit * 1.02))
        left.legend(title="learning rate", ncols=1, loc="lower left", bbox_to_anchor=(0.0, 0.08))
        right.set(xlabel="learning rate [-]", title=f"E after at most {limit} iterations, every motion", xscale="log")
        right.set_xticks(list(finals), [f"{rate:g}" for rate in finals])
        right.minorticks_off()
        right.text(min(finals), threshold, "E0 ", ha="left", va="bottom", color=FAINT)
    return figure


def comparison_bars(ours: Mapping[str, float], theirs: Mapping[str, float], *, ylabel: str) -> Figure:
    """Two bars per name, ours and the paper's, with their values.

    Args:
        ours: name to value.
        theirs: the same names.
        ylabel: quantity and unit.
    """
    with _style():
        figure = _figure((8.0, 3.8))
        axes = figure.subplots()
        x = np.arange(len(ours))
        for shift, colour, label, values in ((-0.2, PALETTE[0], "ours", ours), (0.2, PALETTE[4], "paper", theirs)):
            bars = axes.bar(x + shift, [values[name] for name in ours], 0.38, color=colour, label=label)
            axes.bar_label(bars, fmt="%g", fontsize=9)
        axes.set_xticks(x, list(ours))
        axes.set(xlabel="motion", ylabel=ylabel)
        axes.grid(visible=False, axis="x")
        axes.legend(ncols=2, loc="upper right")
    return figure


def arm_path(
    robot: Robot,
    poses: Sequence[Tensor],
    *,
    paths: Mapping[str, np.ndarray] | None = None,
    points: Mapping[str, np.ndarray] | None = None,
    view: tuple[float, float] = (20.0, -50.0),
    radius: float = 0.075,
) -> Figure:
    """An arm in space: the first pose solid, the others as ghosts, with curves of the tool and named points.

    Args:
        robot: the robot, n joint variables.
        poses: joint values (n,) [rad or m].
        paths: name to (k, 3) positions [m].
        points: name to (3,) positions [m].
        view: elevation and azimuth of the camera [deg].
        radius: of the thickest link [m].
    """
    from matplotlib.patheffects import withStroke

    with _style():
        figure = _figure((8.0, 6.0))
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        joints = [link_poses(robot, torch.as_tensor(q))[:, :3, 3].numpy() for q in poses]
        meshes = [arm_mesh(xyz, radius, skip=None if k == 0 else joints[0]) for k, xyz in enumerate(joints)]
        everything = np.concatenate([*joints, *(np.atleast_2d(p) for p in (paths or {}).values())])
        _floor(axes, everything, meshes)
        _draw_meshes(axes, meshes)
        for colour, (name, xyz) in zip(PALETTE, (paths or {}).items(), strict=False):
            axes.plot(*xyz.T, color="white", linewidth=4.0, zorder=5)
            axes.plot(*xyz.T, color=colour, linewidth=2.2, zorder=6, label=name)
        for name, xyz in (points or {}).items():
            axes.plot(*xyz[:, None], "o", color=INK, markersize=7, markeredgecolor="white", zorder=8)
            label = axes.text(xyz[0], xyz[1], xyz[2] + 0.07, name, zorder=9, ha="center", fontsize=13)
            label.set_path_effects([withStroke(linewidth=3, foreground="white")])
        axes.view_init(*view)
        if paths:
            axes.legend(title="tool on motion", loc="upper left", bbox_to_anchor=(0.0, 1.0), labelspacing=0.25)
    return figure


def save_figure(figure: Figure, path: str | Path, *, dpi: int = 150) -> Path:
    """Write a figure in one go: readers see the old file or the new one, never half of it.

    Args:
        figure: the figure.
        path: PNG or SVG, by its suffix.
        dpi: pixels per inch of a PNG.

    Raises:
        DataError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise DataError(f"{path}: figures are written as {' or '.join(SUFFIXES)}")
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    date = {"Date": None} if path.suffix == ".svg" else {}
    try:
        with _style():
            figure.savefig(partial, format=path.suffix[1:], dpi=dpi, metadata=date)
        partial.replace(path)
    except OSError as error:
        raise DataError(f"{path}: cannot write the figure: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)
    return path


def _style() -> Any:
    """Our settings inside a ``with`` block; matplotlib's own are back afterwards."""
    import matplotlib

    return matplotlib.rc_context(STYLE)


def _figure(size: tuple[float, float]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _grid(count: int, *, size: tuple[float, float]) -> tuple[Figure, list[Any]]:
    """A figure with panels in at most four columns, axes shared; surplus panels are blank."""
    columns = min(count, 4)
    rows = -(-count // columns)
    figure = _figure(size if rows > 1 else (size[0], size[1] * 0.6))
    panels = list(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).flat)
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels


def _outer_labels(panels: Sequence[Any], xlabel: str, ylabel: str) -> None:
    """Labels at the left and below only; a panel above a blank one shows its ticks too."""
    _, columns = panels[0].get_subplotspec().get_gridspec().get_geometry()
    for k, axes in enumerate(panels):
        if k % columns == 0:
            axes.set_ylabel(ylabel)
        if k + columns >= len(panels):
            axes.set_xlabel(xlabel)
            axes.tick_params(labelbottom=True)


def _key(axes: Any, threshold: float, printed: bool) -> None:
    axes.plot([], [], "o-", color=PALETTE[0], label="ours, last iteration")
    if printed:
        axes.plot([], [], "o", markersize=13, fillstyle="none", color=PALETTE[1], label="paper's count")
    axes.plot([], [], "--", color=FAINT, linewidth=1.2, label=f"E0 = {_power(threshold)}")
    axes.legend(loc="center" if not axes.axison else "best")


def _power(value: float) -> str:
    """1e-09 as 1e-9."""
    return f"{value:g}".replace("e-0", "e-")


def _draw_meshes(axes: Any, meshes: Iterable[Mesh]) -> None:
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


def _floor(axes: Any, everything: np.ndarray, meshes: Sequence[Mesh]) -> None:
    """Equal scales, a plain floor at z = 0 with the first arm's shadow, and no walls."""
    from matplotlib.ticker import MultipleLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    low, high = everything.min(axis=0) - 0.25, everything.max(axis=0) + 0.25
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


__all__ = ["PALETTE", "STYLE", "arm_path", "comparison_bars", "convergence", "learning_rates", "save_figure"]
