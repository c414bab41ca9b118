"""Quantities over the workspace, seen from the side: cells by distance from the first axis and by height."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ikgrad.plots.style import FAINT, calm_log, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ikgrad.robot import Robot

ROWS_A_CELL = 5  # cells with fewer stay blank


class Cells(NamedTuple):
    """A quantity on a grid of cells.

    Attributes:
        x: (C + 1,) edges, distance from the first axis [m].
        y: (C + 1,) edges, height [m].
        values: (C, C), rows are heights; NaN where there are too few rows.
    """

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray


def cells_of(
    robot: Robot,
    p: np.ndarray,
    values: np.ndarray,
    *,
    cells: int = 18,
    reduce: Callable[[np.ndarray], Any] = np.median,
) -> Cells:
    """What a quantity is in each part of the workspace.

    Args:
        robot: gives the place of the first axis.
        p: (N, 3) places [m], finite.
        values: (N,) the quantity there.
        cells: along each side.
        reduce: from the rows of a cell to its value.
    """
    axis = robot.detach().tables().origins[0, :2, 3].numpy()
    sides = np.linalg.norm(p[:, :2] - axis, axis=1), p[:, 2]
    edges = [np.linspace(x.min(), x.max() + 1e-9, cells + 1) for x in sides]
    columns, rows = (np.clip(np.digitize(x, e) - 1, 0, cells - 1) for x, e in zip(sides, edges, strict=True))
    grid = np.full((cells, cells), np.nan)
    flat = rows * cells + columns
    order = np.argsort(flat, kind="stable")
    places, starts = np.unique(flat[order], return_index=True)
    for place, inside in zip(places, np.split(values[order], starts[1:]), strict=True):
        if len(inside) >= ROWS_A_CELL:
            grid.flat[place] = reduce(inside)
    return Cells(edges[0], edges[1], grid)


def draw_cells(axes: Any, found: Cells, *, label: str, log: bool = False, top: float | None = None) -> None:
    """A picture of the cells with a colour bar below; words where no cell has enough rows.

    Args:
        axes: to draw in.
        found: of `cells_of`.
        label: quantity and unit.
        log: logarithmic colours.
        top: the scale goes from 0 to this; default: from the smallest to the largest value.
    """
    from matplotlib.colors import LogNorm, Normalize

    axes.grid(visible=False)
    axes.set(xlabel="distance from the first axis [m]", ylabel="height [m]", aspect="equal")
    axes.set(xlim=(min(found.x[0], 0.0), found.x[-1]), ylim=(found.y[0], found.y[-1]))
    drawn = found.values[np.isfinite(found.values)]
    if not len(drawn):
        text = f"no cell has {ROWS_A_CELL} rows"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color=FAINT)
        return
    limits = (drawn.min() / 1.001, drawn.max() * 1.001) if top is None else (0.0, top)
    norm = LogNorm(*limits) if log else Normalize(*limits)
    picture = axes.pcolormesh(found.x, found.y, np.ma.masked_invalid(found.values), cmap="cividis", norm=norm)
    bar = axes.figure.colorbar(picture, ax=axes, label=label, location="bottom", aspect=30)
    if log:
        calm_log(bar.ax.xaxis)


def workspace_errors(
    robot: Robot, p: np.ndarray, position_error: np.ndarray, success: np.ndarray, *, title: str = ""
) -> Figure:
    """Where a solver is exact and where it fails: median position error, and the share that is not solved.

    Args:
        robot: gives the place of the first axis.
        p: (N, 3) where the tip is [m].
        position_error: (N,) [m].
        success: (N,) bool.
        title: above all.

    Example:
        >>> import ikgrad as ik
        >>> p = np.random.default_rng(0).uniform(-1, 1, (500, 3))
        >>> figure = workspace_errors(ik.load_robot("panda"), p, np.full(500, 1e-9), p[:, 2] > 0)
        >>> figure.axes[1].get_title()
        'not solved'
    """
    with styled():
        figure = new_figure((10.0, 5.4))
        draw_workspace(figure, robot, p, position_error, success)
        figure.suptitle(title)
    return figure


def draw_workspace(figure: Any, robot: Robot, p: np.ndarray, position_error: np.ndarray, success: np.ndarray) -> None:
    """The panels of `workspace_errors` in a figure or a part of one; arguments as there."""
    kept = np.isfinite(p).all(axis=1) & np.isfinite(position_error)
    if not kept.any():
        figure.suptitle("no row is finite, so there are no places")
        return
    count = int(np.clip(np.sqrt(kept.sum() / 25), 6, 36))
    smallest = position_error[kept & (position_error > 0)].min(initial=1.0)
    mm = 1e3 * np.maximum(position_error[kept], smallest)
    lost = 100.0 * ~success[kept]
    left, right = figure.subplots(1, 2)
    draw_cells(left, cells_of(robot, p[kept], mm, cells=count), label="median position error [mm]", log=True)
    shares = cells_of(robot, p[kept], lost, cells=count, reduce=np.mean)
    top = max(1.0, float(np.nan_to_num(shares.values).max()))
    draw_cells(right, shares, label="share not solved [% of rows]", top=top)
    left.set_title("median error")
    right.set_title("not solved")


__all__ = ["Cells", "cells_of", "draw_cells", "draw_workspace", "workspace_errors"]
