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
from ikgrad.solvers.question import ROTATION_TOLERANCE, ask, check_mask
from ikgrad.solvers.solution import IKSolution, Reason


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
        weights=np.ones(6) if problem.mask is None else problem.mask.numpy(),
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
    from ikgrad.engine.poses import compare, examine, turn_near

    robot = robot.detach()
    threads, shape = torch.get_num_threads(), T_target.shape[:-2]
    given = check_mask(mask, T_target)
    weights = None if given is None else given.numpy()
    T, valid = examine(T_target.detach().reshape(-1, 4, 4).numpy(), ROTATION_TOLERANCE, threads=threads)
    start = None
    if q0 is not None:
        start = q0.detach().to(torch.float64).expand(*shape, robot.dof).reshape(-1, robot.dof).numpy()
        finite = np.isfinite(start).all(axis=1)
        if not finite.all():
            valid, start = valid & finite, np.where(finite[:, None], start, 0.0)
    chain = engine.pack(robot)
    solved = engine.solve(
        chain, T, start, weights=np.ones(6) if weights is None else weights,
        tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, seed=seed, **_settings(solver),
    )  # fmt: skip
    q = solved.q
    if start is not None:
        unlimited = np.full(robot.dof, math.inf)
        low, high = (chain.q_min, chain.q_max) if limits else (-unlimited, unlimited)
        turn_near(q, start, low, high, robot.periodic.numpy())
    position, rotation = compare(engine.fk(chain, q, threads=threads), T, weights, threads=threads)
    inside = ((q >= chain.q_min) & (q <= chain.q_max)).all(axis=1) if limits else True
    success = valid & (position <= tol_pos) & (rotation <= tol_rot) & inside
    code = np.zeros(len(q), dtype=np.int8)
    answer = IKSolution(*(torch.from_numpy(x) for x in (q, success, code, position, rotation, solved.steps)))
    if not success.all():
        rows = torch.from_numpy(np.flatnonzero(~success))
        options: dict[str, Any] = dict(tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, mask=mask, seed=seed)
        _judge_rows(
            robot,
            T_target.detach().reshape(-1, 4, 4)[rows],
            start,
            solver,
            answer,
            rows,
            torch.from_numpy(valid),
            options,
        )
    return answer if shape == answer.success.shape else answer.reshape(shape)


def _judge_rows(
    robot: Robot,
    T: Tensor,
    start: Any,
    solver: Solver,
    answer: IKSolution,
    rows: Tensor,
    was_valid: Tensor,
    options: dict[str, Any],
) -> None:
    """Name the reasons of the failed rows, in place."""
    from ikgrad.solvers.judge import judge

    q0 = None if start is None else torch.from_numpy(start)[rows]
    problem, _, valid = ask(robot, T, q0=q0, **options)
    verdict = judge(solver, problem, answer.q[rows], answer.steps[rows], valid, torch.float64)
    # The errors stay those of the kernel: torch's batched products round differently in different batches.
    code = verdict.reason_code
    answer.reason_code[rows] = torch.where(code == Reason.converged, Reason.no_convergence, code).to(code.dtype)
    answer.reason_code[rows[~was_valid[rows]]] = Reason.invalid_target  # also rows whose start was not finite
    for error in (answer.position_error, answer.rotation_error):
        error[rows[~was_valid[rows]]] = math.nan


def _settings(solver: LevenbergMarquardt) -> dict[str, Any]:
    return dict(
        damping=solver.damping,
        max_step=solver.step_limit,
        max_starts=solver.max_starts,
        max_steps=solver.steps_per_start,
        threads=torch.get_num_threads(),
    )
