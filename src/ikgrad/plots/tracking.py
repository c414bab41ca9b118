"""Charts of paths that were followed: one panel a quantity, one line a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.style import INK, PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def traces(
    lines: Mapping[str, np.ndarray],
    *,
    panels: Sequence[str],
    xlabel: str,
    x: np.ndarray | None = None,
    log: bool = False,
    limit: float | None = None,
    notes: Sequence[str] | None = None,
    title: str = "",
) -> Figure:
    """Values along a path, panels one above the other.

    Args:
        lines: name to values (N, P); of two or three, later ones are dashed, so that equal ones can be told; more
            than seven are a crowd without names.
        panels: label of each of the P panels, quantity and unit.
        xlabel: what ``x`` is.
        x: (N,) where the rows are; default: their numbers.
        log: logarithmic values.
        limit: every panel reaches from minus this to this.
        notes: a remark in the corner of each panel.
        title: above the figure.
    """
    with styled():
        figure = new_figure((8.0, 1.0 + 2.1 * len(panels)))
        all_axes = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
        for p, (axes, label) in enumerate(zip(all_axes, panels, strict=True)):
            for k, (name, values) in enumerate(lines.items()):
                style = "--" if 0 < k < len(lines) <= 3 else "-"
                where = np.arange(len(values)) if x is None else x
                axes.plot(where, values[:, p], style, color=PALETTE[k % len(PALETTE)], linewidth=1.4, label=name)
            axes.set_ylabel(label)
            axes.margins(x=0.01)
            if log:
                axes.set_yscale("log")
            if limit is not None:
                axes.set_ylim(-limit, limit)
            if notes:
                axes.text(0.99, 0.97, notes[p], transform=axes.transAxes, ha="right", va="top", fontsize=9)
        all_axes[-1].set_xlabel(xlabel)
        if 1 < len(lines) <= len(PALETTE):  # beyond, colours repeat and name nothing
            handles, names = all_axes[0].get_legend_handles_labels()
            columns = min(len(lines), 5 if len(max(lines, key=len)) < 16 else 2)
            figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=9)
        if title:
            figure.suptitle(title, fontsize=11)
    return figure


def curves_in_space(
    curves: Mapping[str, np.ndarray],
    *,
    points: Mapping[str, np.ndarray] | None = None,
    unit: str,
    view: tuple[float, float] = (22.0, -60.0),
    title: str = "",
) -> Figure:
    """Curves in three dimensions with equal scales, the first one broad and pale, and named points.

    Args:
        curves: name to (N, 3).
        points: name to (3,).
        unit: of all coordinates.
        view: elevation and azimuth of the camera [deg].
        title: above the figure.
    """
    with styled():
        figure = new_figure((8.0, 6.4))
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        for k, (name, xyz) in enumerate(curves.items()):
            look = {"color": PALETTE[k - 1], "linewidth": 1.8} if k else {"color": INK, "linewidth": 5.0, "alpha": 0.3}
            axes.plot(*xyz.T, label=name, **look)
        everything = np.concatenate(list(curves.values()))
        for name, xyz in (points or {}).items():
            axes.plot(*xyz[:, None], "o", color=INK, markersize=7, markeredgecolor="white", zorder=8)
            axes.text(*(xyz + 0.04 * np.ptp(everything, axis=0)), name, fontsize=13, zorder=9)
        _widen(axes, everything)
        axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]", zlabel=f"z [{unit}]")
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_pane_color((1, 1, 1, 0))
        axes.view_init(*view)
        axes.legend(loc="upper left")
        if title:
            figure.suptitle(title, fontsize=11)
    return figure


def closeups(
    wanted: np.ndarray,
    followed: Mapping[str, np.ndarray],
    *,
    x: np.ndarray,
    windows: Sequence[tuple[float, float]],
    panels: Sequence[str],
    xlabel: str,
    unit: str,
    title: str = "",
) -> Figure:
    """Pieces of a path as it was wanted and followed, and what is between the two, which the eye cannot see there.

    Args:
        wanted: (N, P) values.
        followed: name to values (N, P).
        x: (N,) where the rows are.
        windows: from and to, of x, for each of the P panels.
        panels: name of each of the P quantities.
        xlabel: what ``x`` is.
        unit: of the values.
        title: above the figure.
    """
    with styled():
        figure = new_figure((10.0, 1.0 + 2.3 * len(panels)))
        grid = figure.subplots(len(panels), 2, squeeze=False)
        for p, (name, (low, high)) in enumerate(zip(panels, windows, strict=True)):
            kept = (x >= low) & (x <= high)
            left, right = grid[p]
            left.plot(x[kept], wanted[kept, p], color=INK, linewidth=3.5, alpha=0.35, label="wanted")
            right.axhline(0.0, color=INK, linewidth=3.5, alpha=0.35)
            for k, (label, values) in enumerate(followed.items()):
                style = "--" if k else "-"
                left.plot(x[kept], values[kept, p], style, color=PALETTE[k], linewidth=1.4, label=label)
                right.plot(x[kept], (values - wanted)[kept, p], style, color=PALETTE[k], linewidth=1.6)
            left.set_ylabel(f"{name} [{unit}]")
            right.set_ylabel(f"error in {name} [{unit}]")
            for axes in (left, right):
                axes.margins(x=0.0)
        for axes in grid[-1]:
            axes.set_xlabel(xlabel)
        grid[0, 0].legend(fontsize=9)
        if title:
            figure.suptitle(title, fontsize=11)
    return figure


def _widen(axes: Any, xyz: np.ndarray) -> None:
    """Equal scales; a narrow side becomes wider and gets fewer ticks, else its labels find no room."""
    from matplotlib.ticker import MaxNLocator

    middle, span = (xyz.max(axis=0) + xyz.min(axis=0)) / 2, np.ptp(xyz, axis=0)
    shown = 1.08 * np.maximum(span, 0.45 * span.max())
    low, high = middle - shown / 2, middle + shown / 2
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(shown, zoom=0.88)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shown / shown.max(), strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(5 * share))))


__all__ = ["closeups", "curves_in_space", "traces"]
