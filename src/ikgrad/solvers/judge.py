"""The verdict on an answer: errors measured, and a reason for every row."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from ikgrad.solvers.attempt import attempt
from ikgrad.solvers.base import Solver
from ikgrad.solvers.closed_form import Puma560ClosedForm
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.solution import IKSolution, Reason


def judge(solver: Solver, problem: Problem, q: Tensor, steps: Tensor, valid: Tensor, dtype: torch.dtype) -> IKSolution:
    """Measure the answer as it will be handed out (in its dtype) and name the reason of every row."""
    rounded = q.to(dtype)
    if dtype != torch.float64:  # rounding must not push a joint over its limit
        low, high = problem.q_min.to(dtype), problem.q_max.to(dtype)
        low = torch.where(low.double() < problem.q_min, low.nextafter(torch.full_like(low, math.inf)), low)
        high = torch.where(high.double() > problem.q_max, high.nextafter(torch.full_like(high, -math.inf)), high)
        rounded = torch.where(problem.inside(q)[:, None], rounded.clamp(low, high), rounded)
    position, rotation = problem.measure(rounded.double())
    met, inside = problem.met(position, rotation), problem.inside(rounded.double())
    code = torch.full_like(steps, Reason.no_convergence, dtype=torch.int8)
    code[met & inside] = Reason.converged
    code[met & ~inside] = Reason.joint_limits
    code[~met & problem.certainly_unreachable()] = Reason.unreachable
    open_rows = torch.nonzero((code == Reason.no_convergence) & valid).flatten()
    if isinstance(solver, Puma560ClosedForm) and len(open_rows):  # a closed form knows exactly
        code[open_rows[solver.out_of_reach(problem.rows(open_rows))]] = Reason.unreachable
    code[open_rows[_only_limits(solver, problem.rows(open_rows), q[open_rows])]] = Reason.joint_limits
    code[~valid] = Reason.invalid_target
    nan = torch.full_like(position, math.nan)
    return IKSolution(
        q=rounded,
        success=code == Reason.converged,
        reason_code=code,
        position_error=torch.where(valid, position, nan),
        rotation_error=torch.where(valid, rotation, nan),
        steps=steps,
    )


def _only_limits(solver: Solver, problem: Problem, q: Tensor) -> Tensor:
    """(B,) True for failed rows that a short run without limits does solve."""
    limited = bool(problem.q_min.isfinite().any() | problem.q_max.isfinite().any())
    if not (isinstance(solver, LevenbergMarquardt) and limited and len(q)):
        return torch.zeros(len(q), dtype=torch.bool, device=q.device)
    free = replace(
        problem,
        q_min=torch.full_like(problem.q_min, -math.inf),
        q_max=torch.full_like(problem.q_max, math.inf),
    )
    answer, _ = attempt(replace(solver, max_starts=8), free, q)
    return problem.met(*problem.measure(answer))
