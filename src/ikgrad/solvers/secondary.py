"""A second wish for `solve_ik`: among the joints that meet the pose, those with the smallest extra residual.

The pose comes first, always. An arm has several branches of solutions, and a redundant one a continuum in each, so
there is a choice left; it is made in rounds, until the residual is zero or the rounds are used up:

1. Solve the pose from several starts (microseconds each in the compiled kernels), and take the answer with the
   smallest residual r.
2. If r is not zero there, go down |r|^2 in the null space of the pose Jacobian, Newton's step for the pose added:

       dq = J^+ e - a N g,   g = R^T r,   N = I - J^+ J,   a = g.N g / |R N g|^2

   with R = dr/dq by autograd. Along the single free direction of a 7-joint arm that is the Gauss-Newton step.

The residual is never squeezed into the pose's own equations, so no weight has to be chosen and no accuracy is lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor

from ikgrad.errors import ShapeError
from ikgrad.solvers.attempt import attempt, middle
from ikgrad.solvers.base import Solver
from ikgrad.solvers.closed_form import Puma560ClosedForm
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.variety import from_many_starts

Residual: TypeAlias = Callable[[Tensor], Tensor]

ROUNDS = (16, 16, 32, 64)  # starts; most rows need the first, and those that are satisfied take part no more
ZERO = 1e-9  # length of a residual that counts as zero
_DOWN, _POLISH = 16, 4  # steps with and without the residual
_LONGEST = 0.3  # largest change of a joint by the residual in one step [rad or m]
_BEYOND = 1.2  # times the exact step: an inequality is met after finitely many


class Choice(NamedTuple):
    """Answers of B rows."""

    q: Tensor  # (B, n)
    steps: Tensor  # (B,)
    score: Tensor  # (B,) what `_score` says


def solve_with_residual(solver: Solver, problem: Problem, q0: Tensor | None, residual: Residual) -> Choice:
    """Joints that meet the poses, and among those make the residual small.

    Args:
        solver: the method that solves the poses.
        problem: B rows.
        q0: (B, n) where to start and where to stay near, or None.
        residual: (B, n) -> (B, m), rows independent of each other.
    """
    home = middle(problem) if q0 is None else q0
    best = Choice(home.clone(), torch.zeros_like(problem.key), torch.full_like(home[:, 0], torch.inf))
    first = 0
    for starts in ROUNDS if solver.restarts else (1,):
        open_rows = torch.nonzero(best.score >= 0).flatten()
        if len(open_rows) == 0:
            break
        part, near = problem.rows(open_rows), home[open_rows]
        found = _round(solver, part, near, q0 is not None, residual, starts, first)
        best.steps[open_rows] += found.steps
        better = found.score < best.score[open_rows]
        best.q[open_rows[better]], best.score[open_rows[better]] = found.q[better], found.score[better]
        first += starts
    return best


def _round(
    solver: Solver, problem: Problem, near: Tensor, stay: bool, residual: Residual, starts: int, first: int
) -> Choice:
    """The best of a few answers, improved in the null space where its residual is not zero."""
    q, steps = _answers(solver, problem, near, starts, first)  # (B, c, n), (B, c)
    every = torch.arange(len(q), device=q.device).repeat_interleave(q.shape[1])
    score = _score(problem.rows(every), q.flatten(0, 1), near[every] if stay else None, residual)
    score, pick = score.view(steps.shape).min(dim=1)
    q = q[torch.arange(len(q), device=q.device), pick]
    low = torch.nonzero(score >= 0).flatten()
    if len(low):
        part = problem.rows(low)
        moved = _descend(part, q[low], residual)
        moved_score = _score(part, moved, near[low] if stay else None, residual)
        better = moved_score < score[low]
        q[low[better]], score[low[better]] = moved[better], moved_score[better]
    return Choice(q, steps.sum(dim=1), score)


def _answers(solver: Solver, problem: Problem, near: Tensor, starts: int, first: int) -> tuple[Tensor, Tensor]:
    """(B, c, n) solutions of the poses as the method finds them, and (B, c) steps."""
    if isinstance(solver, Puma560ClosedForm):
        q = solver.every_branch(problem, near)
        return q, torch.ones(q.shape[:2], dtype=torch.int64, device=q.device)
    if solver.restarts:
        return from_many_starts(solver, problem, near, starts, first=first)
    q, steps = attempt(solver, problem, near)
    return q[:, None], steps[:, None]


def _score(problem: Problem, q: Tensor, near: Tensor | None, residual: Residual) -> Tensor:
    """(B,) the smaller the better: below 0 where the residual is zero, above 1e30 where the pose is not met.

    Among satisfied rows the one nearest to ``near`` wins.
    """
    position, rotation = problem.measure(q)
    met = problem.met(position, rotation) & problem.inside(q)
    size = evaluate(residual, q).norm(dim=-1)
    far = torch.zeros_like(size) if near is None else (q - near).abs().amax(dim=-1)
    score = torch.where(size <= ZERO, far / (1 + far) - 1, size)
    score = torch.where(met & size.isfinite(), score, 1e30 * (1 + position / problem.robot.length + rotation))
    return torch.where(score.isfinite(), score, torch.inf)


def evaluate(residual: Residual, q: Tensor) -> Tensor:
    """(B, m) values, refused if they have another form."""
    r = residual(q)
    if not isinstance(r, Tensor) or r.ndim != 2 or len(r) != len(q) or not r.is_floating_point():
        got = f"{tuple(r.shape)} of {r.dtype}" if isinstance(r, Tensor) else type(r).__name__
        raise ShapeError(f"extra_residual must map (..., n) to floating-point (..., m); for {tuple(q.shape)} got {got}")
    return r.to(q)


def _descend(problem: Problem, q: Tensor, residual: Residual) -> Tensor:
    """(B, n) after some steps down the residual that keep the pose, and some more for the pose alone."""
    q = q.clone()
    for step in range(_DOWN + _POLISH):
        e, J = problem.linearise(q)
        wish = torch.zeros_like(q) if step >= _DOWN else -_gradient(residual, q)
        held = ((q <= problem.q_min) & (wish < 0)) | ((q >= problem.q_max) & (wish > 0))
        J = torch.where(held[:, None, :], 0.0, J)
        inverse = _damped_inverse(J)
        wish = torch.where(held, 0.0, wish)
        wish = wish - (inverse @ (J @ wish[..., None]))[..., 0]
        if step < _DOWN:
            wish = _scaled(residual, q, wish)
        dq = (inverse @ e[..., None])[..., 0] + wish
        q = (q + dq.nan_to_num()).clamp(problem.q_min, problem.q_max)
    return q


def _damped_inverse(J: Tensor) -> Tensor:
    """(B, n, 6) the pseudo-inverse J^T (J J^T + tiny)^-1, defined also where J has lost rank or rows (masks)."""
    A = J @ J.mT
    tiny = 1e-10 * A.diagonal(dim1=-2, dim2=-1).sum(dim=-1) + 1e-14
    A = A + tiny[:, None, None] * torch.eye(A.shape[-1]).to(A)
    return torch.linalg.solve(A, J).mT


def _gradient(residual: Residual, q: Tensor) -> Tensor:
    """(B, n) R^T r."""
    with torch.enable_grad():
        x = q.detach().requires_grad_()
        r = evaluate(residual, x)
        return torch.autograd.grad(r.square().sum() / 2, x)[0]


def _scaled(residual: Residual, q: Tensor, u: Tensor) -> Tensor:
    """(B, n) a step along u: to the smallest linearised residual and a little beyond, shortened if it is long.

    R u comes from the gradient of a gradient: w -> R^T w is linear, and its own gradient along u is R u.
    """
    with torch.enable_grad():
        x = q.detach().requires_grad_()
        r = evaluate(residual, x)
        w = torch.zeros_like(r, requires_grad=True)
        (pulled,) = torch.autograd.grad(r, x, w, create_graph=True)
        (pushed,) = torch.autograd.grad(pulled, w, u)
    length = -(pushed * r.detach()).sum(dim=-1) / (pushed.square().sum(dim=-1) + 1e-300)
    step = _BEYOND * length[:, None] * u
    return step * (_LONGEST / step.abs().amax(dim=-1, keepdim=True).clamp(min=_LONGEST))
