"""Histograms of errors over many decades, with percentiles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ikgrad.evaluation.table import number
from ikgrad.plots.style import INK

PERCENTILES = ((0.5, "-", "median"), (0.95, "--", "95 %"), (0.999, ":", "99.9 %"))


def log_bins(errors: Sequence[np.ndarray], count: int = 70) -> np.ndarray:
    """Edges for all that is finite and positive, evenly spaced on a logarithmic axis.

    Example:
        >>> edges = log_bins([np.array([1e-3, 0.0, np.inf]), np.array([1.0])], 30)
        >>> len(edges), bool(edges[0] < 1e-3), bool(edges[-1] > 1)
        (30, True, True)
    """
    every = np.concatenate([np.ravel(values) for values in errors])
    every = every[np.isfinite(every) & (every > 0)]
    low, high = (every.min(), every.max()) if len(every) else (0.1, 1.0)
    return np.geomspace(low / 1.5, high * 1.5, count)


def draw_percentiles(axes: Any, errors: np.ndarray, *, show: Callable[[float], str] = number) -> None:
    """A line for each percentile, and their values above the panel.

    Args:
        axes: with a logarithmic x axis.
        errors: (N,), of which what is not finite counts as infinitely large.
        show: a value as text.
    """
    ranked = np.sort(np.where(np.isfinite(errors), errors, np.inf))
    marks = []
    for share, style, _ in PERCENTILES:
        marks.append(ranked[min(len(ranked) - 1, int(share * len(ranked)))])
        if 0 < marks[-1] < np.inf:
            axes.axvline(marks[-1], color=INK, linewidth=1.5, linestyle=style)
    axes.set_title(" / ".join(map(show, marks)), loc="right", fontsize=10, pad=2)


def percentile_key(axes: Any) -> None:
    """Entries of a legend for the lines of `draw_percentiles`."""
    for _, style, name in PERCENTILES:
        axes.plot([], [], style, color=INK, linewidth=1.5, label=name)


__all__ = ["PERCENTILES", "draw_percentiles", "log_bins", "percentile_key"]
