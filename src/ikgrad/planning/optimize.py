"""The door: starts, goals and obstacles in, trajectories that keep clear of them out."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision import PolynomialMotion, check_motion, link_segments
from ikgrad.collision.obstacles import Obstacles
from ikgrad.planning.checks import check_ends, check_settings, slack_of
from ikgrad.planning.curve import each, make_curve
from ikgrad.planning.descent import descend
from ikgrad.planning.problem import Problem, make_problem
from ikgrad.planning.result import OptimizedTrajectory, PlanReason
from ikgrad.planning.starts import detours, straight_line
from ikgrad.robot import Robot
from ikgrad.solvers.starts import row_keys
from ikgrad.trajectory import Trajectory
from ikgrad.trajectory.checks import Numbers

_PER_SEGMENT = 12  # samples between two points that the penalty sees; the verdict does not rest on them
_SMOOTHNESS = (1e-7, 1e-8)  # lambda of the first descent and of the others: more, and long ways cut into the margin
_TOLERANCE = 1e-5  # [m] of the proof; ends nearer to the margin than half of this cannot be proven
_SHOWN = 200  # times at which the clearance that is reported is looked at
_BLOCK = 512  # rows in memory at a time


class _Found(NamedTuple):
    """What is known about B rows."""

    vias: Tensor  # (B, v, n)
    code: Tensor  # (B,) int8
    clearance: Tensor  # (B,)
    steps: Tensor  # (B,)


@torch.no_grad()
def optimize_trajectory(
    robot: Robot,
    q_start: Tensor,
    q_goal: Tensor,
    obstacles: Obstacles,
    *,
    margin: float = 0.02,
    link_radius: Tensor | float = 0.0,
    vias: int = 8,
    kind: str = "quintic",
    duration: float | None = None,
    velocity_max: Numbers | None = None,
    acceleration_max: Numbers | None = None,
    jerk_max: Numbers | None = None,
    max_steps: int = 50,
    restarts: int = 8,
    seed: int = 0,
) -> OptimizedTrajectory:
    """Smooth trajectories from rest to rest that keep clear of obstacles and inside the joint limits.

    The via points x of `ikgrad.via_point_trajectory` are free. Damped Gauss-Newton steps, with gradients by autograd
    through links and distances, make them the smallest of

        1/2N sum_s (r_s^2 + |o_s|^2) + lambda/2 integral |jerk|^2 dt

    over N samples s, where r_s is how far all links come into the margin around the obstacles, o_s what lies outside
    the limits (`ikgrad.planning.problem`). The first descent begins on the straight line. Rows that fail begin again
    on a random detour, the best of 16 by cost, with a tenth of lambda. A row is a success if
    `ikgrad.collision.check_motion` proves the margin for all times and the exact extremes of all joints lie inside the
    limits.

    Rows are independent: what comes out for a pair does not depend on what else is in the batch. Results carry no
    gradient.

    Args:
        robot: the robot, n joint variables.
        q_start: (..., n) [rad or m], inside the limits.
        q_goal: (..., n), broadcasts against ``q_start``. Turns of unlimited joints are taken as they are given.
        obstacles: K `Spheres` or `Capsules`, the same for all rows.
        margin: distance that links must keep from obstacles at all times [m].
        link_radius: radius of the links as capsules [m], one for all or (L,).
        vias: free points between start and goal, evenly spaced in time.
        kind: of the curve, see `ikgrad.via_point_trajectory`.
        duration: of every trajectory [s], longer only where limits ask for it. Without it each trajectory is as fast
            as its limits allow, or takes 1 s where there are none.
        velocity_max: limits on joint speeds, a number or (n,) [rad/s or m/s].
        acceleration_max: the same for accelerations.
        jerk_max: the same for jerks.
        max_steps: steps of one descent.
        restarts: further descents of a row that fails.
        seed: of the detours; with the row's own start and goal it determines them.

    Raises:
        ShapeError: shapes do not fit, or obstacles differ from row to row.
        ConfigError: an end is not finite or outside the limits, or a setting makes no sense. An end that collides is
            no error: see `OptimizedTrajectory.reason` and `OptimizedTrajectory.raise_if_failed`.
        UnknownNameError: no such kind.

    Source:
        Steps that are covariant in the sense of CHOMP (M. Zucker et al., CHOMP: Covariant Hamiltonian optimization for
        motion planning, 2013): measured along the path, not by its parameters.

    Differences:
        Gauss-Newton instead of gradient steps, a spline instead of waypoints, and a proof at the end.

    Example:
        >>> import ikgrad as ik, torch
        >>> from ikgrad.collision import Spheres
        >>> robot = ik.load_robot("panda")
        >>> ball = Spheres(torch.tensor([[0.5, 0.0, 0.5]]), torch.tensor([0.12]))
        >>> q = torch.tensor([[-0.8, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8], [0.8, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8]])
        >>> found = ik.optimize_trajectory(robot, q[0], q[1], ball, link_radius=0.06, velocity_max=2.0)
        >>> found.reason.item(), bool(found.clearance >= 0.02), bool(found.trajectory.peak().max() < 2.001)
        ('converged', True, True)
    """
    counts = {"vias": (vias, 1), "max_steps": (max_steps, 1), "restarts": (restarts, 0)}
    check_settings(robot, obstacles, link_radius, margin, duration, counts)
    start, goal = check_ends(robot, q_start, q_goal)
    batch, dtype = start.shape[:-1], start.dtype
    curve = make_curve(vias, kind, _PER_SEGMENT, _SHOWN, start.device)
    a, b = (q.double().reshape(-1, robot.dof) for q in (start, goal))
    problem = make_problem(robot, obstacles, curve, a, b, margin, link_radius, _SMOOTHNESS[0])
    rows = torch.arange(len(a), device=a.device)
    parts = [_solve(problem.rows(block), max_steps, restarts, seed) for block in rows.split(_BLOCK)]
    found = _Found(*(torch.cat(columns) for columns in zip(*parts, strict=True)))
    path = curve.trajectories(problem.points(found.vias))
    times, coefficients = (x.to(dtype).reshape(*batch, *x.shape[1:]) for x in (path.times, path.coefficients))
    trajectory = _timed(Trajectory(times, coefficients), duration, velocity_max, acceleration_max, jerk_max)
    code, clearance, steps = (x.reshape(batch) for x in (found.code, found.clearance.to(dtype), found.steps))
    return OptimizedTrajectory(trajectory, code == PlanReason.converged, code, clearance, steps)


def _solve(problem: Problem, max_steps: int, restarts: int, seed: int) -> _Found:
    """Descents from the line and from detours, until every row is proven or given up."""
    key = row_keys(torch.stack([problem.start, problem.goal], dim=1), None, seed)
    best = straight_line(problem)
    code, steps = _judge_ends(problem), torch.zeros_like(key)
    cost = torch.full_like(best[:, 0, 0], torch.inf)
    live = torch.nonzero(code == PlanReason.no_convergence).flatten()
    for attempt in range(restarts + 1):
        if len(live) == 0:
            break
        part = problem.rows(live)._replace(smoothness=_SMOOTHNESS[min(attempt, 1)])
        first = straight_line(part) if attempt == 0 else detours(part, key[live], attempt)
        vias, value, taken = descend(part, first, max_steps)
        good = _proven(part, vias)
        value = torch.where(good, -1.0, value)
        better = value < cost[live]
        best[live[better]], cost[live[better]] = vias[better], value[better]
        steps[live] += taken
        code[live[good]] = PlanReason.converged
        live = live[~good]
    return _Found(best, code, _clearance(problem, best), steps)


def _judge_ends(problem: Problem) -> Tensor:
    """(B,) int8: which rows have an end that is too near to an obstacle; the others are not solved yet."""
    near = []
    for q in (problem.start, problem.goal):
        distance = problem.obstacles.distance(link_segments(problem.robot, q), problem.link_radius)
        near.append(distance.flatten(1).amin(dim=1) < problem.margin)
    code = torch.full_like(near[0], PlanReason.no_convergence, dtype=torch.int8)
    code[near[1]] = PlanReason.goal_collides
    code[near[0]] = PlanReason.start_collides
    return code


def _proven(problem: Problem, vias: Tensor) -> Tensor:
    """(B,) bool: margin and joint limits are kept at all times."""
    path = problem.curve.trajectories(problem.points(vias))
    robot, slack = problem.robot, slack_of(problem.start.dtype)
    low, high = path.extremes()
    inside = (low >= robot.q_min.to(low) - slack) & (high <= robot.q_max.to(high) + slack)
    motion = PolynomialMotion(path.times, path.coefficients)
    thick = problem.link_radius + problem.margin  # links that are thicker by the margin touch nothing
    return inside.all(dim=-1) & check_motion(robot, motion, problem.obstacles, link_radius=thick, tol=_TOLERANCE).free


def _clearance(problem: Problem, vias: Tensor) -> Tensor:
    """(B,) the smallest of the distances at many times."""
    q = each(problem.curve.shown, problem.points(vias))
    distance = problem.obstacles.distance(link_segments(problem.robot, q), problem.link_radius)
    return distance.flatten(1).amin(dim=1)


def _timed(
    path: Trajectory,
    duration: float | None,
    velocity_max: Numbers | None,
    acceleration_max: Numbers | None,
    jerk_max: Numbers | None,
) -> Trajectory:
    """The same path, 1 s long when it comes, in the time that is wanted or needed."""
    limits = {"velocity_max": velocity_max, "acceleration_max": acceleration_max, "jerk_max": jerk_max}
    least = torch.full_like(path.times[..., 0], 1.0 if duration is None else duration)
    if all(limit is None for limit in limits.values()):
        return path.scaled(least)
    low, high = path.extremes()
    moves = (high - low).amax(dim=-1) > slack_of(low.dtype)  # rounding is no motion that could be fast
    needed = torch.where(moves, path.stretch_to(**limits), 0.0)
    if duration is not None:
        return path.scaled(torch.maximum(needed, least))
    return path.scaled(torch.where(needed > 0, needed, least))
