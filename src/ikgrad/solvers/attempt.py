"""One run of a method on a batch: a start for every row, the loop or the kernels, angles brought into range."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.solvers.base import Solver
from ikgrad.solvers.compiled import run_compiled, serves
from ikgrad.solvers.levenberg import LevenbergMarquardt, best_start
from ikgrad.solvers.loop import run
from ikgrad.solvers.problem import Problem


def attempt(solver: Solver, problem: Problem, q0: Tensor | None) -> tuple[Tensor, Tensor]:
    """Run the method and bring the angles into range by whole turns.

    Args:
        solver: the method.
        problem: B rows.
        q0: (B, n) starts; None: the method's own, or the middle of the range.

    Returns:
        (B, n) joints and (B,) steps.
    """
    if serves(solver, problem.T_target):
        q, steps = run_compiled(solver, problem, q0)
    else:
        q, steps = run(solver, problem, _start(solver, problem) if q0 is None else q0)
    near = q0 if q0 is not None and solver.restarts else q
    return whole_turns(problem, q, near), steps


def _start(solver: Solver, problem: Problem) -> Tensor:
    if isinstance(solver, LevenbergMarquardt):
        return best_start(problem, torch.zeros_like(problem.key))
    return middle(problem)


def middle(problem: Problem) -> Tensor:
    """(B, n) the middle of the sampling range."""
    low, high = problem.robot.sampling_range
    return ((low + high) / 2).to(problem.T_target).expand(len(problem.key), -1).clone()


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
