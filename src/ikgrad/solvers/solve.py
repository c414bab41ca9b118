"""`solve_ik`: check the question, run a method, and measure its answer with forward kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.robot import Robot
from ikgrad.solvers.attempt import attempt, middle
from ikgrad.solvers.base import Solver, State
from ikgrad.solvers.compiled import serves, solve_compiled
from ikgrad.solvers.implicit import attach_gradient
from ikgrad.solvers.judge import judge
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.loop import run
from ikgrad.solvers.question import Question, ask, check, check_mask
from ikgrad.solvers.secondary import Residual, solve_with_residual
from ikgrad.solvers.seeding import Seeder, seeds
from ikgrad.solvers.solution import IKSolution, Reason
from ikgrad.solvers.variety import distinct_solutions

_DEFAULT = LevenbergMarquardt()


def solve_ik(
    robot: Robot,
    T_target: Tensor,
    *,
    q0: Tensor | None = None,
    solver: Solver | None = None,
    solutions: int = 1,
    tol_pos: float = 1e-6,
    tol_rot: float = 1e-6,
    limits: bool = True,
    mask: Tensor | Sequence[float] | None = None,
    seed: int = 0,
    seeder: Seeder | None = None,
    extra_residual: Residual | None = None,
) -> IKSolution:
    """Joint values that bring the tip to a pose, for any batch of poses.

    Gradients flow from ``q`` to ``T_target``, and to link parameters given by `Robot.with_geometry`, by the implicit
    function theorem, whatever method found the answer: dq = J_f^+ de. Joints that stand at a limit are held;
    redundant arms take the smallest joint motion; failed rows have zero gradient (see ``success``). Second
    derivatives through the answer are refused.

    Rows are independent of each other. Work is done in float64 whatever the dtype; the answer has the dtype of
    ``T_target``. Success is never the method's own claim: the errors are recomputed by forward kinematics.

    Args:
        robot: the robot, n joint variables.
        T_target: (..., 4, 4) wanted poses of ``robot.tip`` in ``robot.base`` [m].
        q0: (..., n) or (n,) where to start, and where to stay near; default: the method draws starts itself
            (`LevenbergMarquardt`) or starts in the middle of the range.
        solver: the method; default `LevenbergMarquardt`.
        solutions: number k of different solutions wanted for each pose, nearest to ``q0`` (largest joint change)
            first; with k > 1 the results have one more batch dimension, and places for which no further solution
            was found fail with ``no_convergence``. Redundant arms have a continuum; k spread samples come out.
        tol_pos: largest position error of a success [m].
        tol_rot: largest rotation error of a success [rad].
        limits: stay inside the joint limits.
        mask: six zeros or ones [x, y, z, rx, ry, rz]: which errors count, along the axes of the *target's own* frame.
            (1, 1, 1, 0, 0, 0) is position only; (1, 1, 1, 1, 1, 0) leaves the turn about the tool's z free.
        seed: of the random starts; a row's starts depend on its own content and on this alone.
        seeder: where to start instead of ``q0``: a function of poses (..., 4, 4) that returns joints (..., n), or
            (..., k, n) of which the nearest is taken; an inverter is one, and if it starts from the present joints,
            these are ``q0``. See `ikgrad.solvers.seeding`.
        extra_residual: a second wish, a function (..., n) -> (..., m) of the joints, differentiable by autograd and
            each row for itself: among the joints that meet the pose, take those with the smallest residual. The pose
            keeps its priority and ``success`` its meaning; see `ikgrad.solvers.secondary`. Made for residuals that
            are zero where all is well, as `ikgrad.collision.clearance_residual`: the search ends there. Among
            such answers the nearest to ``q0`` wins. It is called with float64 joints; gradients through the
            answer are those of the pose alone.

    Returns:
        An `IKSolution` with the batch shape of ``T_target``.

    Raises:
        ShapeError: shapes or dtypes do not fit.
        ConfigError: a tolerance, the mask or ``solutions`` makes no sense, or there are both ``q0`` and a
            ``seeder`` that does not look at it.
        RobotError: ``seeder`` is for another robot.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 1000, seed=0))
        >>> solution = ik.solve_ik(robot, T)
        >>> solution.q.shape, bool(solution.success.all())
        (torch.Size([1000, 7]), True)
    """
    check(robot, T_target, q0, tol_pos, tol_rot)
    if solutions < 1:
        raise ConfigError(f"solutions must be at least 1, got {solutions}")
    solver = _DEFAULT if solver is None else solver
    if seeder is not None:
        q0 = seeds(robot, T_target, seeder, q0)
    if extra_residual is not None and solutions > 1:
        raise ConfigError("extra_residual chooses one solution a row; leave solutions at 1")
    fast = solutions == 1 and extra_residual is None and T_target.dtype == torch.float64
    if fast and serves(solver, T_target):
        answer = solve_compiled(
            robot, T_target, q0, solver, tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, mask=mask, seed=seed
        )
    else:
        options: dict[str, Any] = dict(tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, mask=mask, seed=seed)
        question = ask(robot, T_target, q0=q0, **options)
        answer = _in_torch(solver, question, solutions, T_target.dtype, extra_residual)
    if torch.is_grad_enabled() and (T_target.requires_grad or robot.requires_grad):
        answer = _differentiable(robot, T_target, answer, limits, mask)
    shape = T_target.shape[:-2] if solutions == 1 else (*T_target.shape[:-2], solutions)
    return answer if answer.success.shape == shape else answer.reshape(shape)


@torch.no_grad()
def _in_torch(
    solver: Solver, question: Question, solutions: int, dtype: torch.dtype, extra: Residual | None
) -> IKSolution:
    if solutions == 1:
        return _one(solver, question, dtype, extra)
    return _several(solver, question, solutions, dtype)


def _one(solver: Solver, question: Question, dtype: torch.dtype, extra: Residual | None) -> IKSolution:
    """One solution a row."""
    problem, start, valid = question
    rows = torch.nonzero(valid).flatten()
    q = middle(problem) if start is None else start.clone()
    steps = torch.zeros(len(valid), dtype=torch.int64, device=valid.device)
    near = None if start is None else start[rows]
    if extra is None:
        q[rows], steps[rows] = attempt(solver, problem.rows(rows), near)
    else:
        q[rows], steps[rows], _ = solve_with_residual(solver, problem.rows(rows), near, extra)
    return judge(solver, problem, q, steps, valid, dtype)


def _several(solver: Solver, question: Question, k: int, dtype: torch.dtype) -> IKSolution:
    """Several (k) solutions a row, flat: (B * k, ...)."""
    problem, start, valid = question
    rows = torch.nonzero(valid).flatten()
    every = torch.arange(len(valid), device=valid.device).repeat_interleave(k)
    home = middle(problem) if start is None else start
    q = home[every].view(-1, k, home.shape[-1])
    steps = torch.zeros(len(valid), k, dtype=torch.int64, device=valid.device)
    found = torch.zeros_like(steps, dtype=torch.bool)
    near = None if start is None else start[rows]
    q[rows], steps[rows], found[rows] = distinct_solutions(solver, problem.rows(rows), near, k)
    answer = judge(solver, problem.rows(every), q.flatten(0, 1), steps.flatten(), valid[every], dtype)
    repeated = ~found.flatten() & answer.success
    answer.success[repeated] = False
    answer.reason_code[repeated] = Reason.no_convergence
    return answer


def _differentiable(
    robot: Robot, T_target: Tensor, answer: IKSolution, limits: bool, mask: Tensor | Sequence[float] | None
) -> IKSolution:
    """The answer with gradients to the target and the geometry; flat."""
    rows, q = T_target.shape[:-2].numel(), answer.q.reshape(-1, robot.dof).double()
    T = T_target.reshape(-1, 4, 4).to(torch.float64)
    if len(q) != rows:
        T = T.repeat_interleave(len(q) // max(rows, 1), dim=0)
    held = (q == robot.q_min.to(q)) | (q == robot.q_max.to(q)) if limits else torch.zeros_like(q, dtype=torch.bool)
    success = answer.success.reshape(-1)
    q = attach_gradient(robot, q, T, success=success, held=held, mask=check_mask(mask, T))
    return replace(answer, q=q.to(T_target.dtype).reshape(answer.q.shape))


class Trace(NamedTuple):
    """Every iterate of one IK run, the start first."""

    q: Tensor  # (steps, n)
    position_error: Tensor  # (steps,) [m]
    rotation_error: Tensor  # (steps,) [rad]


def trace_ik(
    robot: Robot,
    T_target: Tensor,
    *,
    q0: Tensor,
    solver: Solver | None = None,
    tol_pos: float = 1e-6,
    tol_rot: float = 1e-6,
    limits: bool = True,
    mask: Tensor | Sequence[float] | None = None,
    seed: int = 0,
) -> Trace:
    """The way of one pose through a method, for figures and lessons; arguments as in `solve_ik`.

    Args:
        robot: the robot, n joint variables.
        T_target: (4, 4) wanted pose.
        q0: (n,) start.
        solver: the method.
        tol_pos: [m]
        tol_rot: [rad]
        limits: stay inside the joint limits.
        mask: which errors count.
        seed: of the random starts.

    Example:
        >>> import ikgrad as ik, torch
        >>> from ikgrad.solvers.solve import trace_ik
        >>> robot = ik.load_robot("ur5e")
        >>> q = torch.full((6,), 0.5, dtype=torch.float64)
        >>> trace = trace_ik(robot, ik.forward_kinematics(robot, q), q0=q + 0.2, solver=ik.NewtonRaphson())
        >>> bool(trace.position_error[-1] < 1e-6)
        True
    """
    if T_target.ndim != 2:
        raise ShapeError(f"T_target must have shape (4, 4) here, got {tuple(T_target.shape)}")
    check(robot, T_target, q0, tol_pos, tol_rot)
    solver = LevenbergMarquardt() if solver is None else solver
    problem, start, valid = ask(
        robot, T_target, q0=q0, tol_pos=tol_pos, tol_rot=tol_rot, limits=limits, mask=mask, seed=seed
    )
    if start is None or not bool(valid.all()):
        raise ConfigError("T_target must be a rigid transform and q0 finite")
    states: list[State] = []
    run(solver, problem, start, watch=states.append)
    return Trace(*(torch.cat([getattr(state, name) for state in states]) for name in Trace._fields))
