"""`solve_ik`: check the question, run a method, and measure its answer with forward kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.kinematics import check_poses, check_q
from ikgrad.robot import Robot
from ikgrad.solvers.base import Solver
from ikgrad.solvers.levenberg import LevenbergMarquardt, best_start
from ikgrad.solvers.loop import run
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.solution import IKSolution, Reason
from ikgrad.solvers.starts import row_keys
from ikgrad.solvers.variety import distinct_solutions

ROTATION_TOLERANCE = 1e-4  # of |R^T R - I|: far beyond float32 rounding, far below any visible skew


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
) -> IKSolution:
    """Joint values that bring the tip to a pose, for any batch of poses.

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

    Returns:
        An `IKSolution` with the batch shape of ``T_target``.

    Raises:
        ShapeError: shapes or dtypes do not fit.
        ConfigError: a tolerance, the mask or ``solutions`` makes no sense.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 1000, seed=0))
        >>> solution = ik.solve_ik(robot, T)
        >>> solution.q.shape, bool(solution.success.all())
        (torch.Size([1000, 7]), True)
    """
    solver = LevenbergMarquardt() if solver is None else solver
    _check(robot, T_target, q0, solutions, tol_pos, tol_rot)
    shape, count = T_target.shape[:-2], T_target.shape[:-2].numel()
    T = T_target.detach().reshape(count, 4, 4).to(torch.float64)
    start = None if q0 is None else q0.detach().to(T).expand(*shape, robot.dof).reshape(count, robot.dof)
    valid = is_rigid(T) & (True if start is None else start.isfinite().all(dim=-1))
    T = torch.where(valid[:, None, None], _orthonormal(T), torch.eye(4).to(T))
    start = None if start is None else torch.where(valid[:, None], start, torch.zeros_like(start))
    problem = Problem(
        robot=robot.to(T.device, torch.float64),
        T_target=T,
        key=row_keys(T, start, seed),
        q_min=_limit(robot.q_min, limits, T, -math.inf),
        q_max=_limit(robot.q_max, limits, T, math.inf),
        mask=_mask(mask, T),
        tol_pos=tol_pos,
        tol_rot=tol_rot,
    )
    rows = torch.nonzero(valid).flatten()
    q = middle(problem) if start is None else start.clone()
    steps = torch.zeros(count, dtype=torch.int64, device=T.device)
    near = None if start is None else start[rows]
    if solutions == 1:
        q[rows], steps[rows] = _attempt(solver, problem.rows(rows), near)
        answer = _judge(solver, problem, q, steps, valid, T_target.dtype)
        return _reshape(answer, shape)
    q, steps = (x.repeat_interleave(solutions, dim=0).view(count, solutions, *x.shape[1:]) for x in (q, steps))
    found = torch.zeros_like(steps, dtype=torch.bool)
    q[rows], steps[rows], found[rows] = distinct_solutions(solver, problem.rows(rows), near, solutions, _attempt)
    every = torch.arange(count, device=T.device).repeat_interleave(solutions)
    answer = _judge(solver, problem.rows(every), q.flatten(0, 1), steps.flatten(), valid[every], T_target.dtype)
    repeated = ~found.flatten() & answer.success
    answer.success[repeated] = False
    answer.reason_code[repeated] = Reason.no_convergence
    return _reshape(answer, (*shape, solutions))


def _check(robot: Robot, T: Tensor, q0: Tensor | None, solutions: int, tol_pos: float, tol_rot: float) -> None:
    check_poses("T_target", T)
    if q0 is not None:
        check_q(robot, q0, "q0")
        try:
            q0.expand(*T.shape[:-2], robot.dof)
        except RuntimeError as error:
            raise ShapeError(f"q0 of shape {tuple(q0.shape)} does not fit poses of shape {tuple(T.shape)}") from error
    for name, value in (("tol_pos", tol_pos), ("tol_rot", tol_rot)):
        if not value > 0:
            raise ConfigError(f"{name} must be positive, got {value}")
    if solutions < 1:
        raise ConfigError(f"solutions must be at least 1, got {solutions}")


def _mask(mask: Tensor | Sequence[float] | None, like: Tensor) -> Tensor | None:
    if mask is None:
        return None
    given = torch.as_tensor(mask).to(like)
    if given.shape != (6,):
        raise ShapeError(f"mask must have shape (6,), got {tuple(given.shape)}")
    if not bool(((given == 0) | (given == 1)).all()) or not bool(given.any()):
        raise ConfigError(f"mask must be six zeros or ones, not all zero, got {given.tolist()}")
    return None if bool(given.all()) else given


def _limit(limit: Tensor, on: bool, like: Tensor, none: float) -> Tensor:
    return limit.to(like) if on else torch.full_like(limit, none).to(like)


def is_rigid(T: Tensor) -> Tensor:
    """(...) True where (..., 4, 4) is a finite rigid transform: |R^T R - I| small, det R > 0, last row 0 0 0 1."""
    R = torch.where(T.isfinite().all(dim=-1).all(dim=-1)[..., None, None], T, torch.zeros_like(T))[..., :3, :3]
    skew = (R.mT @ R - torch.eye(3).to(T)).abs().amax(dim=(-2, -1))
    bottom = (T[..., 3, :] - torch.tensor([0.0, 0.0, 0.0, 1.0]).to(T)).abs().amax(dim=-1)
    return (skew <= ROTATION_TOLERANCE) & (bottom <= ROTATION_TOLERANCE) & (torch.linalg.det(R) > 0)


def _orthonormal(T: Tensor) -> Tensor:
    """Remove the rounding of a target's rotation: two steps R <- R (3 I - R^T R) / 2, each squaring the error."""
    T, R = T.clone(), T[..., :3, :3]
    for _ in range(2):
        R = R @ (1.5 * torch.eye(3).to(R) - 0.5 * R.mT @ R)
    T[..., :3, :3] = R
    T[..., 3, :] = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(T)
    return T


def middle(problem: Problem) -> Tensor:
    """(B, n) the middle of the sampling range."""
    low, high = problem.robot.sampling_range
    return ((low + high) / 2).to(problem.T_target).expand(len(problem.key), -1).clone()


def _attempt(solver: Solver, problem: Problem, q0: Tensor | None) -> tuple[Tensor, Tensor]:
    """Run the method and bring the angles into range by whole turns: (B, n) and (B,) steps."""
    if q0 is not None:
        start = q0
    elif isinstance(solver, LevenbergMarquardt):
        start = best_start(problem, torch.zeros_like(problem.key), solver.candidates)
    else:
        start = middle(problem)
    q, steps = run(solver, problem, start)
    near = q0 if q0 is not None and solver.restarts else q
    return whole_turns(problem, q, near), steps


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


def _judge(solver: Solver, problem: Problem, q: Tensor, steps: Tensor, valid: Tensor, dtype: torch.dtype) -> IKSolution:
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


def _reshape(solution: IKSolution, shape: tuple[int, ...] | torch.Size) -> IKSolution:
    fields = {name: getattr(solution, name) for name in IKSolution.__dataclass_fields__}
    n = solution.q.shape[-1]
    return IKSolution(**{name: x.reshape(*shape, n) if name == "q" else x.reshape(shape) for name, x in fields.items()})
