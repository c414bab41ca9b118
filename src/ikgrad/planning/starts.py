"""Where a descent begins: on the straight line, then on detours that depend on the row alone."""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.planning.problem import Problem
from ikgrad.solvers.starts import random_configurations

_CANDIDATES = 16
_SIZES = (0.6, 1.0, 1.3, 1.0)  # how far detours go towards their random configuration; beyond it at 1.3


def straight_line(problem: Problem) -> Tensor:
    """(B, v, n) vias of the straight motion with the least jerk: 10 u^3 - 15 u^4 + 6 u^5 of the way at time u."""
    s = _progress(problem)
    return problem.start[:, None] + s[:, None] * (problem.goal - problem.start)[:, None]


def detours(problem: Problem, key: Tensor, attempt: int) -> Tensor:
    """(B, v, n) the cheapest of a few smooth detours by way of random configurations.

    Args:
        problem: B rows.
        key: (B,) int64 of `ikgrad.solvers.starts.row_keys`.
        attempt: number of the attempt; each draws other configurations.
    """
    s, c = _progress(problem), _CANDIDATES
    draw = attempt * c + torch.arange(c, device=key.device).expand(len(key), c)
    over = random_configurations(problem.robot, key, draw) - (problem.start + problem.goal)[:, None] / 2  # (B, c, n)
    size = torch.tensor(_SIZES).to(over).repeat(c // len(_SIZES))
    bump = 4 * s * (1 - s)
    vias = straight_line(problem)[:, None] + bump[:, None] * (size[:, None] * over)[:, :, None]  # (B, c, v, n)
    every = torch.arange(len(key), device=key.device)
    cost = problem.rows(every.repeat_interleave(c)).cost(vias.flatten(0, 1)).view(-1, c)
    return vias[every, cost.argmin(dim=1)]


def _progress(problem: Problem) -> Tensor:
    u = problem.curve.times[1:-1]
    return u**3 * (10 - 15 * u + 6 * u**2)
