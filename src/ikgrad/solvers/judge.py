"""The verdict on an answer: angles brought into range, errors measured, a reason for every row."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from ikgrad.solvers.base import Solver
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.loop import run
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.solution import IKSolution, Reason


def whole_turns(problem: Problem, q: Tensor, near: Tensor) -> Tensor:
    """Add whole turns so that each angle comes into its range, as near as can be to ``near``.

    With ``near = q`` this is eq. (12) of the APPS paper: nothing happens to an angle that is in range.
    An angle that no number of turns brings into its range is left alone.
    """
    turn = 2 * math.pi
    slack = 1e-12
    fewest = torch.ceil((problem.q_min - q) / turn - slack)
    most = torch.floor((problem.q_max - q) / turn + slack)
    wanted = torch.round((near - q) / turn)
    turns = torch.minimum(torch.maximum(wanted, fewest), most)
    possible = problem.robot.periodic & (fewest <= most) & turns.isfinite()
    moved = (q + turn * turns).clamp(problem.q_min, problem.q_max)
    return torch.where(possible & (turns != 0), moved, q)


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
    answer, _ = run(replace(solver, max_starts=8), free, q)
    return problem.met(*problem.measure(answer))
