"""The picture of a solved batch: errors, steps and reasons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.histograms import draw_percentiles, log_bins, percentile_key
from ikgrad.plots.style import PALETTE, new_figure, power, styled
from ikgrad.plots.workspace import draw_workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ikgrad.robot import Robot


COLOURS = (PALETTE[0], PALETTE[1])  # converged, and all else


def solve_summary(
    position_error: np.ndarray,
    rotation_error: np.ndarray,
    steps: np.ndarray,
    reasons: np.ndarray,
    *,
    title: str = "",
    robot: Robot | None = None,
    p: np.ndarray | None = None,
) -> Figure:
    """Histograms of the errors and of the steps, and a bar for each reason.

    Lines and the numbers above them are percentiles over all rows; what is not finite counts as infinitely large.

    Args:
        position_error: (N,) [m]; zero is drawn at the smallest error there is.
        rotation_error: (N,) [rad], likewise.
        steps: (N,)
        reasons: (N,) text.
        title: above all.
        robot: with ``p``: draw the errors over the workspace, too, see `workspace_errors`.
        p: (N, 3) where the tip is [m].

    Example:
        >>> errors, reasons = np.array([1e-9, 0.0, np.nan]), np.array(["converged", "converged", "invalid_target"])
        >>> len(solve_summary(errors, errors, np.array([7, 8, 0]), reasons).axes)
        4
    """
    solved = reasons == "converged"
    with styled():
        figure, upper, lower = _parts(robot is not None and p is not None)
        axes = upper.subplots(2, 2)
        _errors(axes[0, 0], position_error, solved, "position error [m]")
        _errors(axes[0, 1], rotation_error, solved, "rotation error [rad]")
        _steps(axes[1, 0], steps, solved)
        _reasons(axes[1, 1], reasons)
        for colour, name in zip(COLOURS, ("converged", "other reasons"), strict=True):
            axes[0, 0].bar(0, 0, color=colour, label=name)
        percentile_key(axes[0, 0])
        upper.legend(loc="outside upper center", ncols=5, title=title, title_fontsize=13)
        if lower is not None and robot is not None and p is not None:
            draw_workspace(lower, robot, p, position_error, solved)
    return figure


def _parts(with_workspace: bool) -> tuple[Figure, Any, Any]:
    """The whole, the place for the charts, and perhaps one for the workspace."""
    if not with_workspace:
        figure = new_figure((10.0, 6.8))
        return figure, figure, None
    figure = new_figure((10.0, 12.0))
    upper, lower = list(figure.subfigures(2, 1, height_ratios=(6.8, 5.2)))  # type: ignore[arg-type]
    return figure, upper, lower


def _errors(axes: Any, error: np.ndarray, solved: np.ndarray, label: str) -> None:
    if not np.isfinite(error).any():
        axes.set(xlabel=label, ylabel="rows [-]")
        axes.text(0.5, 0.5, "no row is finite", transform=axes.transAxes, ha="center")
        return
    positive = error[np.isfinite(error) & (error > 0)]
    least = positive.min() if len(positive) else 1e-17
    drawn = np.maximum(error, least)
    bins = log_bins([drawn], 60)
    parts = [drawn[which & np.isfinite(drawn)] for which in (solved, ~solved)]
    axes.hist(parts, bins=bins, stacked=True, color=COLOURS)
    axes.set(xlabel=label, ylabel="rows [-]", xscale="log", yscale="log")
    draw_percentiles(axes, drawn, show=lambda value: power(float(f"{value:.1e}")))


def _steps(axes: Any, steps: np.ndarray, solved: np.ndarray) -> None:
    top = max(int(np.percentile(steps, 99.5)), 1)  # a few rows with hundreds of steps would hide the others
    edges = np.arange(top + 2) - 0.5 if top < 60 else np.linspace(0, top, 61)
    parts = [np.minimum(steps[which], top) for which in (solved, ~solved)]
    axes.hist(parts, bins=edges, stacked=True, color=COLOURS)
    rest = f", the last bin: {top} and more" if steps.max() > top else ""
    axes.set(xlabel=f"steps [-]{rest}", ylabel="rows [-]", yscale="log")


def _reasons(axes: Any, reasons: np.ndarray) -> None:
    names, numbers = np.unique(reasons, return_counts=True)
    bars = axes.barh(names.tolist(), numbers, color=[COLOURS[int(name != "converged")] for name in names])
    axes.bar_label(bars, labels=[f"{number:,}" for number in numbers], padding=3)
    axes.margins(x=0.2)
    axes.grid(False, axis="y")
    axes.set(xlabel="rows [-]")
