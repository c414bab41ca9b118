"""The picture of a solved batch: errors, steps and reasons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.style import PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def solve_summary(
    position_error: np.ndarray,
    rotation_error: np.ndarray,
    steps: np.ndarray,
    reasons: np.ndarray,
    *,
    title: str = "",
) -> Figure:
    """Histograms of the errors (log10) and of the steps, and a bar for each reason.

    Args:
        position_error: (N,) [m]; NaN is left out, zero is drawn at the smallest error there is.
        rotation_error: (N,) [rad], likewise.
        steps: (N,)
        reasons: (N,) text.
        title: above all.

    Example:
        >>> errors, reasons = np.array([1e-9, 0.0, np.nan]), np.array(["converged", "converged", "invalid_target"])
        >>> len(solve_summary(errors, errors, np.array([7, 8, 0]), reasons).axes)
        4
    """
    with styled():
        figure = new_figure((10.0, 6.4))
        axes = figure.subplots(2, 2)
        _errors(axes[0, 0], position_error, "position error", "m")
        _errors(axes[0, 1], rotation_error, "rotation error", "rad")
        _steps(axes[1, 0], steps)
        _reasons(axes[1, 1], reasons)
        figure.suptitle(title)
    return figure


def _errors(axes: Any, error: np.ndarray, name: str, unit: str) -> None:
    finite = error[np.isfinite(error)]
    if len(finite):
        positive = finite[finite > 0]
        smallest = positive.min() if len(positive) else 1e-17
        axes.hist(np.log10(np.maximum(finite, smallest)), bins=60, color=PALETTE[0])
    axes.set(xlabel=f"log10 of {name} [{unit}]", ylabel="rows", yscale="log")


def _steps(axes: Any, steps: np.ndarray) -> None:
    top = max(int(np.percentile(steps, 99.5)), 1)  # a few rows with hundreds of steps would hide the others
    axes.hist(np.minimum(steps, top), bins=min(top, 60), color=PALETTE[0])
    rest = f" (the last bin holds all from {top} on)" if steps.max() > top else ""
    axes.set(xlabel=f"steps{rest}", ylabel="rows")


def _reasons(axes: Any, reasons: np.ndarray) -> None:
    names, numbers = np.unique(reasons, return_counts=True)
    colours = [PALETTE[2] if name == "converged" else PALETTE[1] for name in names]
    bars = axes.barh(names.tolist(), numbers, color=colours)
    axes.bar_label(bars, labels=[f"{number:,}" for number in numbers], padding=3)
    axes.margins(x=0.2)
    axes.grid(False, axis="y")
    axes.set(xlabel="rows")
