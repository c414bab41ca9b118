"""The way from `solve_ik` to the compiled Levenberg-Marquardt kernels and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np
import torch
from torch import Tensor

from ikgrad.robot import Robot
from ikgrad.solvers.base import Solver
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.question import ROTATION_TOLERANCE, Question, ask, check_mask
from ikgrad.solvers.solution import IKSolution, Reason

TABLE_STARTS = 8  # as many as a cell of the table holds


def serves(solver: Solver, T: Tensor) -> TypeGuard[LevenbergMarquardt]:
    """True if the kernels can run this method on these tensors."""
    return isinstance(solver, LevenbergMarquardt) and solver.compiled and T.device.type == "cpu"


def run_compiled(solver: LevenbergMarquardt, problem: Problem, q0: Tensor | None) -> tuple[Tensor, Tensor]:
    """The kernels on a `Problem`: (B, n) joints and (B,) steps."""
    from ikgrad import engine

    limits = bool(problem.q_min.isfinite().any() | problem.q_max.isfinite().any())
    solved = engine.solve(
        engine.pack(problem.robot),
        problem.T_target.numpy(),
        None if q0 is None else q0.numpy(),
        weights=None if problem.mask is None else problem.mask.numpy(),
        tol_pos=problem.tol_pos,
        tol_rot=problem.tol_rot,
        limits=limits,
        seed=problem.seed,
        **_settings(solver),
    )
    return torch.from_numpy(solved.q), torch.from_numpy(solved.steps)


def solve_compiled(
    robot: Robot,
    T_target: Tensor,
    q0: Tensor | None,
    solver: LevenbergMarquardt,
    *,
    tol_pos: float,
    tol_rot: float,
    limits: bool,
    mask: Tensor | Sequence[float] | None,
    seed: int,
) -> IKSolution:
    """`solve_ik` for float64 targets on the CPU without a detour through torch operations; one solution a row.

    The answer is measured by the forward-kinematics kernel, which shares no state with the solve. Rows that failed,
    few as a rule, go through the same verdict as those of every other method.
    """
    from ikgrad import engine
    from ikgrad.engine.poses import examine, measure, turn_near

    robot = robot.detach()
    threads, shape, n = torch.get_num_threads(), tuple(T_target.shape[:-2]), robot.dof
    given = check_mask(mask, T_target)
    weights = None if given is None else given.numpy()
    T, valid = examine(T_target.detach().numpy().reshape(-1, 4, 4), ROTATION_TOLERANCE, threads=threads)
    start = None
    if q0 is not None:
        start = q0.detach().to(torch.float64).expand(*shape, n).reshape(-1, n).numpy()
        finite = np.isfinite(start).all(axis=1)
        if not finite.all():
            valid, start = valid & finite, np.where(finite[:, None], start, 0.0)
    chain = engine.pack(robot)
    solved = engine.solve(
        chain, T, start, weights=weights, tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, seed=seed,
        **_settings(solver),
    )  # fmt: skip
    q = solved.q
    low, high = (chain.q_min, chain.q_max) if limits else (np.full(n, -math.inf), np.full(n, math.inf))
    if start is not None:
        turn_near(q, start, low, high, robot.periodic.numpy())
    verdict = measure(
        engine.fk(chain, q, threads=threads), T, valid, q, q_min=low, q_max=high, mask=weights,
        tol_pos=tol_pos, tol_rot=tol_rot, threads=threads,
    )  # fmt: skip
    code = np.zeros(len(q), dtype=np.int8)
    rows = (verdict.success, code, verdict.position_error, verdict.rotation_error, solved.steps)
    answer = IKSolution(torch.from_numpy(q.reshape(*shape, n)), *(torch.from_numpy(x.reshape(shape)) for x in rows))
    if not verdict.success.all():
        options: dict[str, Any] = dict(tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, mask=mask, seed=seed)
        failed = torch.from_numpy(np.flatnonzero(~verdict.success))
        q0 = None if start is None else torch.from_numpy(start)[failed]
        targets = T_target.detach().reshape(-1, 4, 4)[failed]
        _judge_rows(solver, ask(robot, targets, q0=q0, **options), answer, failed, torch.from_numpy(valid))
    return answer


def _judge_rows(
    solver: LevenbergMarquardt, question: Question, answer: IKSolution, rows: Tensor, valid: Tensor
) -> None:
    """Name the reasons of the failed rows, in place.

    The errors stay those of the kernel: torch's batched products round differently in different batches.
    """
    from ikgrad.solvers.judge import judge

    q, steps = answer.q.view(-1, answer.q.shape[-1])[rows], answer.steps.view(-1)[rows]
    code = judge(solver, question.problem, q, steps, question.valid, torch.float64).reason_code
    code[code == Reason.converged] = Reason.no_convergence
    code[~valid[rows]] = Reason.invalid_target  # also rows whose start was not finite
    answer.reason_code.view(-1)[rows] = code
    for error in (answer.position_error, answer.rotation_error):
        error.view(-1)[rows[~valid[rows]]] = math.nan


def _settings(solver: LevenbergMarquardt) -> dict[str, Any]:
    return dict(
        damping=solver.damping,
        max_step=solver.step_limit,
        max_starts=solver.max_starts,
        max_steps=solver.steps_per_start,
        guesses=TABLE_STARTS if solver.table else 0,
        threads=torch.get_num_threads(),
    )
