"""The one loop that all torch methods run in: finished rows leave, the best iterate is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.solvers.base import Solver, State
from ikgrad.solvers.problem import Problem


class Result(NamedTuple):
    """Where the loop left every row."""

    q: Tensor  # (B, n) the final iterate if the method said done, else the best
    steps: Tensor  # (B,) evaluations


def run(solver: Solver, problem: Problem, q0: Tensor, *, watch: Callable[[State], None] | None = None) -> Result:
    """Iterate until every row is done or has used ``solver.max_steps`` evaluations.

    Args:
        solver: the method.
        problem: B rows.
        q0: (B, n) starts.
        watch: called with every state (before finished rows leave).
    """
    best = torch.full(q0.shape[:1], torch.inf, dtype=q0.dtype, device=q0.device)
    q = q0.clone()
    steps = torch.zeros(len(q0), dtype=torch.int64, device=q0.device)
    active = torch.arange(len(q0), device=q0.device)
    state = solver.init(problem, q0) if len(q0) else None
    for count in range(1, solver.max_steps + 1):
        if state is None:
            break
        if watch is not None:
            watch(state)
        merit = state.position_error / problem.robot.length + state.rotation_error
        merit = torch.where(merit.isfinite() & state.q.isfinite().all(dim=-1), merit, torch.inf)
        steps[active] = count
        keep = (merit < best[active]) | (state.done & merit.isfinite())
        q[active[keep]], best[active[keep]] = state.q[keep], merit[keep]
        left = torch.nonzero(~state.done).flatten()
        if len(left) == 0 or count == solver.max_steps:
            break
        if len(left) < len(active):
            active, state, problem = active[left], state.rows(left), problem.rows(left)
        state = solver.step(problem, state)
    return Result(q, steps)
