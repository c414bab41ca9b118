"""The comparisons: Newton-Raphson, the printed settings, eq. (20) as printed, learning rates, random starts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ikgrad.config import AppsConfig
from ikgrad.data import sample_configurations
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.apps.descent import descend
from ikgrad.papers.apps.experiment import Motion, entry_error
from ikgrad.papers.apps.tables import printed_newton
from ikgrad.robot import load_robot
from ikgrad.solvers.apps import Apps
from ikgrad.solvers.base import Solver
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.newton import NewtonRaphson
from ikgrad.solvers.solve import solve_ik

NEWTON_TOLERANCE = 1e-9  # [m] and [rad]: Newton's last steps are quadratic, so a sharp bar costs one step


@dataclass(frozen=True)
class NewtonRow:
    """Newton-Raphson on one motion, from the paper's start; None: not converged, or FALSE in the paper."""

    motion: str
    iterations: int | None
    mae_mm: float
    printed_iterations: int | None
    printed_mae_mm: float | None


@dataclass(frozen=True)
class DescentRow:
    """Gradient descent on one motion with one setting."""

    motion: str
    eta: float
    iterations: int | None  # None: not converged within max_steps
    max_steps: int
    E_final: float  # plain sum of squares at the last iterate
    E_best: float  # the smallest on the way
    joints_moved: bool  # any joint left its start


@dataclass(frozen=True)
class RandomRow:
    """One method on pairs of a random start and a random reachable pose."""

    method: str
    count: int
    reached: float  # share of poses reached, judged by forward kinematics
    inside_limits: float  # share of poses reached with all joints in their ranges
    iterations_median: float | None  # over the poses reached
    iterations_p95: float | None
    max_steps: int
    ms_per_pose: float  # wall time of the batch over its size


def newton_rows(motions: Sequence[Motion], config: AppsConfig, *, tool_frame_error: bool) -> tuple[NewtonRow, ...]:
    """Newton-Raphson from the paper's own starts.

    Args:
        motions: the seven motions.
        config: step limit. The tolerances are `NEWTON_TOLERANCE`, much sharper than the descent's.
        tool_frame_error: the inconsistent variant: rotation error in the tool frame, Jacobian in the base frame.
    """
    T, q0 = _goals(motions)
    robot, solver = load_robot("kr210"), NewtonRaphson(tool_frame_error, config.newton_max_steps)
    solution = solve_ik(
        robot, T, q0=q0, solver=solver, limits=False, tol_pos=NEWTON_TOLERANCE, tol_rot=NEWTON_TOLERANCE
    )
    offset = forward_kinematics(robot, solution.q)[:, :3, 3] - T[:, :3, 3]
    mae_mm = (offset.abs().mean(-1) * 1e3).tolist()
    printed = printed_newton()
    return tuple(
        NewtonRow(motion.name, int(steps) if success else None, mae, printed[motion.name][1], printed[motion.name][0])
        for motion, steps, success, mae in zip(motions, solution.steps, solution.success, mae_mm, strict=True)
    )


def descent_rows(motions: Sequence[Motion], apps: Apps, rates: Sequence[float]) -> tuple[DescentRow, ...]:
    """Every motion with every learning rate, all rows in one batch, from the paper's own starts.

    Args:
        motions: the seven motions.
        apps: all other settings.
        rates: learning rates.
    """
    return tuple(row for row, _ in descent_curves(motions, apps, rates))


def descent_curves(motions: Sequence[Motion], apps: Apps, rates: Sequence[float]) -> list[tuple[DescentRow, Tensor]]:
    """`descent_rows`, each with its curve (k,) of E, the plain sum of squares."""
    robot = load_robot("kr210")
    T, q0 = (x.repeat(len(rates), *[1] * (x.ndim - 1)) for x in _goals(motions))
    eta = torch.tensor(rates, dtype=torch.float64).repeat_interleave(len(motions))
    paths = descend(robot, T, q0, apps, eta)
    names = [motion.name for motion in motions] * len(rates)
    threshold = (apps.E0 or 0.0) * (2 if apps.half_sum else 1)
    results = []
    for name, rate, T_target, path in zip(names, eta.tolist(), T, paths, strict=True):
        E = entry_error(forward_kinematics(robot, path), T_target)
        iterations = len(path) if E[-1] <= threshold else None
        moved = bool((path[-1] != path[0]).any())
        row = DescentRow(name, rate, iterations, apps.max_steps, float(E[-1]), float(E.min()), moved)
        results.append((row, E))
    return results


def stable_rates(motions: Sequence[Motion]) -> tuple[float, ...]:
    """The largest learning rate that is stable at the end of each motion.

    Near a solution E is e^T e with Hessian 2 J^T J, J the derivative of the twelve pose entries; gradient descent on a
    quadratic is stable for eta < 2 / lambda_max(2 J^T J) = 1 / lambda_max(J^T J).
    """
    robot = load_robot("kr210")
    rates = []
    for motion in motions:
        J = torch.autograd.functional.jacobian(lambda q: forward_kinematics(robot, q)[:3].flatten(), motion.q)
        rates.append(1 / float(torch.linalg.matrix_norm(J, ord=2)) ** 2)
    return tuple(rates)


def random_pairs(count: int, *, seed: int) -> tuple[Tensor, Tensor]:
    """(count, 4, 4) reachable goals [m] and (count, 6) starts [rad], both uniform in the joint ranges.

    The first k pairs do not depend on ``count``.
    """
    robot = load_robot("kr210")
    goal, start = sample_configurations(robot, 2 * count, seed=seed).reshape(count, 2, 6).unbind(1)
    return forward_kinematics(robot, goal), start


def random_row(method: str, solver: Solver, config: AppsConfig) -> RandomRow:
    """One method on the random pairs; a pose counts as reached within the tolerances of ``config``."""
    T, q0 = random_pairs(config.random_starts, seed=config.seed)
    solve = partial(solve_ik, load_robot("kr210"), solver=solver, tol_pos=config.tol_pos, tol_rot=config.tol_rot)
    solve(T[:1], q0=q0[:1])  # compiling and importing are not timed
    begin = time.perf_counter()
    solution = solve(T, q0=q0, seed=config.seed)
    seconds = time.perf_counter() - begin
    reached = (solution.position_error <= config.tol_pos) & (solution.rotation_error <= config.tol_rot)
    steps = solution.steps[reached].numpy()
    median, p95 = np.percentile(steps, [50, 95]).tolist() if len(steps) else (None, None)
    share, inside = (float(x.double().mean()) for x in (reached, solution.success))
    return RandomRow(method, len(T), share, inside, median, p95, solver.max_steps, seconds / len(T) * 1e3)


def random_methods(config: AppsConfig) -> dict[str, Solver]:
    """The methods of the random-start study: the paper's two, APPS with half the rate, and the package's default."""
    apps = replace(Apps.reproduces(), max_steps=config.random_max_steps)
    return {
        "APPS, eta 0.1": apps,
        "APPS, eta 0.05": replace(apps, eta=0.05),
        "Newton-Raphson": NewtonRaphson(max_steps=config.newton_max_steps),
        "Levenberg-Marquardt": LevenbergMarquardt(),
    }


def _goals(motions: Sequence[Motion]) -> tuple[Tensor, Tensor]:
    return torch.stack([m.T_target for m in motions]), torch.stack([m.q_start for m in motions])
