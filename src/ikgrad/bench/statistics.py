"""Medians, percentiles and bootstrap intervals of paired timings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 4000


class Interval(NamedTuple):
    """An estimate and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def median_interval(samples: Sequence[float] | np.ndarray) -> Interval:
    """Median of samples with a 95 % percentile-bootstrap interval; the same samples give the same interval.

    Example:
        >>> median_interval([2.0, 2.0, 2.0])
        Interval(value=2.0, low=2.0, high=2.0)
    """
    values = np.asarray(samples, dtype=np.float64)
    draws = np.random.default_rng(0).integers(0, len(values), size=(RESAMPLES, len(values)))
    low, high = np.percentile(np.median(values[draws], axis=1), [2.5, 97.5])
    return Interval(float(np.median(values)), float(low), float(high))


def paired_ratio(slow: Sequence[float] | np.ndarray, fast: Sequence[float] | np.ndarray) -> Interval:
    """How many times slower, from timings taken in turns: the median over the rounds of slow / fast.

    Example:
        >>> paired_ratio([4.0, 6.0, 10.0], [2.0, 3.0, 5.0]).value
        2.0
    """
    return median_interval(np.asarray(slow, dtype=np.float64) / np.asarray(fast, dtype=np.float64))


def percentile(samples: Sequence[float] | np.ndarray, percent: float) -> float:
    """A percentile of the samples that are no NaN; NaN if there are none."""
    values = np.asarray(samples, dtype=np.float64)
    values = values[~np.isnan(values)]
    return float(np.percentile(values, percent)) if len(values) else float("nan")
