"""Several different solutions of the same pose."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.solvers.attempt import attempt
from ikgrad.solvers.base import Solver
from ikgrad.solvers.closed_form import Puma560ClosedForm
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.starts import random_configurations

DIFFERENT = 1e-3  # largest joint change below which two answers are the same solution [rad or m]
STARTS_PER_SOLUTION = 16


def distinct_solutions(solver: Solver, problem: Problem, q0: Tensor | None, k: int) -> tuple[Tensor, Tensor, Tensor]:
    """Up to k different solutions per row, sorted by largest joint change from ``q0``.

    They come from many starts, or from the branches of a closed form.

    Args:
        solver: the method; run once from each start.
        problem: B rows.
        q0: (B, n) where to stay near, or None for the middle of the range.
        k: how many.

    Returns:
        (B, k, n) joints; (B, k) steps of the attempt behind each; (B, k) bool, False where no further solution was
        found (then the joints are those of some attempt).
    """
    rows, n = len(problem.key), problem.robot.dof
    low, high = problem.robot.sampling_range
    home = ((low + high) / 2).to(problem.T_target).expand(rows, n) if q0 is None else q0
    if isinstance(solver, Puma560ClosedForm):
        q = solver.every_branch(problem, home)
        steps = torch.ones(q.shape[:2], dtype=torch.int64, device=q.device)
    else:
        q, steps = from_many_starts(solver, problem, home, max(32, STARTS_PER_SOLUTION * k))
    every = torch.arange(rows, device=q.device).repeat_interleave(q.shape[1])
    flat = q.flatten(0, 1)
    met = problem.rows(every).met(*problem.rows(every).measure(flat)) & problem.inside(flat)
    return _pick(problem, q, steps, met.view(steps.shape), home, k)


def from_many_starts(
    solver: Solver, problem: Problem, home: Tensor, starts: int, *, first: int = 0
) -> tuple[Tensor, Tensor]:
    """(B, s, n) answers from random starts number ``first``, ... and (B, s) steps; start 0 is ``home``."""
    rows, n = home.shape
    every = torch.arange(rows, device=problem.key.device).repeat_interleave(starts)
    draw = torch.arange(first, first + starts, device=problem.key.device).expand(rows, starts) + (1 << 32)
    q_start = random_configurations(problem.robot, problem.key, draw)
    if first == 0:
        q_start[:, 0] = home
    q, steps = attempt(solver, problem.rows(every), q_start.flatten(0, 1).clamp(problem.q_min, problem.q_max))
    return q.view(rows, starts, n), steps.view(rows, starts)


def _pick(
    problem: Problem, q: Tensor, steps: Tensor, met: Tensor, home: Tensor, k: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Nearest first, skipping repeats of what was already taken, k times over the whole batch at once."""
    distance = (q - home[:, None]).abs().amax(dim=-1)  # (B, s)
    distance = torch.where(met, distance, math.inf)
    every = torch.arange(len(q), device=q.device)
    picked_q, picked_steps, found = [], [], []
    for _ in range(k):
        best = distance.argmin(dim=1)
        choice = q[every, best]
        picked_q.append(choice)
        picked_steps.append(steps[every, best])
        found.append(distance[every, best].isfinite())
        change = q - choice[:, None]
        turned = change - 2 * math.pi * torch.round(change / (2 * math.pi))
        change = torch.where(problem.robot.periodic, turned, change)
        distance = torch.where(change.abs().amax(dim=-1) < DIFFERENT, math.inf, distance)
    return torch.stack(picked_q, dim=1), torch.stack(picked_steps, dim=1), torch.stack(found, dim=1)
