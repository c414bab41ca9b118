"""The figure of ``ikgrad solve --plot``: errors, steps and reasons of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def solve_summary(
    position_error: np.ndarray,
    rotation_error: np.ndarray,
    steps: np.ndarray,
    reasons: np.ndarray,
    path: str | Path,
    *,
    title: str = "",
) -> None:
    """Draw histograms of the errors (log10) and steps, and a bar for each reason.

    Args:
        position_error: (N,) [m]; NaN is left out, zero is drawn at the smallest error there is.
        rotation_error: (N,) [rad]
        steps: (N,)
        reasons: (N,) text
        path: ``.png``, ``.pdf`` or ``.svg``.
        title: above all.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp(), "summary.png")
        >>> errors, reasons = np.array([1e-9, 2e-8, 1e-3]), np.array(["converged", "converged", "unreachable"])
        >>> solve_summary(errors, errors, np.array([7, 8, 90]), reasons, path)
        >>> path.stat().st_size > 10_000
        True
    """
    from matplotlib.figure import Figure  # no pyplot: no display and no global state

    figure = Figure(figsize=(10, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    _errors(axes[0, 0], position_error, "position error", "m")
    _errors(axes[0, 1], rotation_error, "rotation error", "rad")
    _steps(axes[1, 0], steps)
    _reasons(axes[1, 1], reasons)
    figure.suptitle(title)
    figure.savefig(path, dpi=120)


def _errors(axes: Any, error: np.ndarray, name: str, unit: str) -> None:
    finite = error[np.isfinite(error)]
    if len(finite):
        positive = finite[finite > 0]
        smallest = positive.min() if len(positive) else 1e-17
        axes.hist(np.log10(np.maximum(finite, smallest)), bins=60, color="tab:blue")
    axes.set(xlabel=f"log10 of {name} [{unit}]", ylabel="rows", yscale="log")


def _steps(axes: Any, steps: np.ndarray) -> None:
    top = max(int(np.percentile(steps, 99.5)), 1)  # a few rows with hundreds of steps would hide the others
    axes.hist(np.minimum(steps, top), bins=min(top, 60), color="tab:green")
    rest = f" (the last bin holds all from {top} on)" if steps.max() > top else ""
    axes.set(xlabel=f"steps{rest}", ylabel="rows")


def _reasons(axes: Any, reasons: np.ndarray) -> None:
    names, numbers = np.unique(reasons, return_counts=True)
    colours = ["tab:green" if name == "converged" else "tab:red" for name in names]
    bars = axes.barh(names.tolist(), numbers, color=colours)
    axes.bar_label(bars, labels=[f"{number:,}" for number in numbers], padding=3)
    axes.margins(x=0.2)
    axes.set(xlabel="rows")
