"""Damped Gauss-Newton steps on the vias, every row with a damping of its own.

    (A + (1 + mu) lambda K) dx = -gradient

A is the curvature of clearance and limits, K the metric of smoothness. Damping along K instead of along the unit
matrix makes every step a smooth change of the path, however few samples pull at it: what covariant gradient descent
does with K^-1 gradient, with the curvature of the obstacles on top.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.planning.problem import Model, Problem

_FIRST_DAMPING, _LARGEST_DAMPING = 10.0, 1e9
_STALL = 5e-3  # a relative decrease that counts as none; two in a row end a descent


def descend(problem: Problem, vias: Tensor, max_steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Move the vias of B rows downhill until nothing is gained. Rows that are done leave the batch.

    Args:
        problem: B rows.
        vias: (B, v, n) where to begin.
        max_steps: steps of a row.

    Returns:
        (B, v, n) vias, (B,) their cost and (B,) int64 steps.
    """
    x, K = vias.clone(), problem.metric()
    live = torch.arange(len(x), device=x.device)
    steps, cost = torch.zeros_like(live), torch.zeros_like(x[:, 0, 0])
    damping, stalled = torch.full_like(cost, _FIRST_DAMPING), torch.zeros_like(live)
    now, part = problem.model(x), problem
    cost[:] = now.cost
    for _ in range(max_steps):
        if len(live) == 0:
            break
        step, promised = _step(now, K, damping)
        trial = x[live] + step[:, : x[0].numel()].reshape(-1, *x.shape[1:])
        new = part.model(trial)
        better = new.cost < now.cost  # never true for NaN
        gain = torch.where(better, now.cost - new.cost, 0.0)
        stalled = torch.where(torch.maximum(gain, promised) <= _STALL * now.cost, stalled + 1, 0)
        damping = _adapted(damping, gain / promised, better)
        x[live[better]] = trial[better]
        now = Model(*(torch.where(better.view(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(new, now, strict=True)))
        steps[live] += 1
        cost[live] = now.cost
        going = (stalled < 2) & (damping < _LARGEST_DAMPING) & (promised > 0)
        if not bool(going.all()):
            kept = torch.nonzero(going).flatten()
            live, damping, stalled = live[kept], damping[kept], stalled[kept]
            now, part = Model(*(a[kept] for a in now)), part.rows(kept)
    return x, cost, steps


def _step(now: Model, K: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """(B, c) changes of the vias and (B,) decreases that the model promises; not positive where there is none."""
    full = now.curvature + (1 + damping)[:, None, None] * K
    factor, failed = torch.linalg.cholesky_ex(full)
    step = -torch.cholesky_solve(now.gradient[..., None], factor)[..., 0]
    step = torch.where((failed == 0)[:, None], step, 0.0)
    bent = ((now.curvature + K) * step[:, None]).sum(dim=-1)
    promised = -(step * (now.gradient + bent / 2)).sum(dim=-1)
    return step, promised.nan_to_num(0.0)


def _adapted(damping: Tensor, ratio: Tensor, better: Tensor) -> Tensor:
    """Less damping where the model was right, more where it was wrong."""
    factor = torch.where(ratio > 0.75, 0.2, torch.where(ratio < 0.25, 3.0, 1.0))
    return damping * torch.where(better, factor, 6.0).to(damping)
