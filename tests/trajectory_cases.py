"""Via points that many trajectory tests share."""

from __future__ import annotations

import math

import torch
from torch import Tensor

KINDS = ("4-3-4", "3-5-3", "cubic", "quintic")
CASES = [(kind, m) for kind in KINDS for m in (2, 3, 4, 5, 9) if kind != "3-5-3" or m >= 4]
FULL = {"start_velocity": 0.3, "end_velocity": -0.4, "start_acceleration": 0.5, "end_acceleration": 0.7}


def random_points(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def random_times(*shape: int, seed: int = 0) -> Tensor:
    """Rising, with durations between 0.2 and 2 and a start that is not 0."""
    steps = torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return (0.2 + 1.8 * steps).cumsum(-1) - 1.5


def ends_for(kind: str) -> dict[str, float]:
    """As many end conditions as the kind takes."""
    if kind == "cubic":
        return {name: FULL[name] for name in ("start_velocity", "end_acceleration")}
    return dict(FULL)


def inside(times: Tensor, count: int, seed: int = 0) -> Tensor:
    """(..., count) random times between the first and the last break."""
    unit = torch.rand(*times.shape[:-1], count, dtype=times.dtype, generator=torch.Generator().manual_seed(seed))
    return times[..., :1] + unit * (times[..., -1:] - times[..., :1])


def left_limit(coefficients: Tensor, h: Tensor, derivative: int) -> Tensor:
    """(..., S, n) derivative at the end of every segment, term by term."""
    total = torch.zeros_like(coefficients[..., 0, :])
    for i in range(derivative, coefficients.shape[-2]):
        total = total + math.perm(i, derivative) * coefficients[..., i, :] * h[..., None] ** (i - derivative)
    return total
