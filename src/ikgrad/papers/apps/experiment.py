"""The experiment: a KR 210 moves its tool round a closed path in seven motions, each starting where the last ended.

Notation of the paper: a motion starts at the joint values I, the algorithm returns R_1, and R_2 is R_1 rounded to
0.01 deg, which stands for what the real robot reaches and is the I of the next motion. Poses are (4, 4), joint
values (6,) in radians inside and in degrees where the name says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.apps.descent import descend
from ikgrad.papers.printed import find_row, numbers, read_table
from ikgrad.robot import Robot, load_robot
from ikgrad.solvers.apps import Apps
from ikgrad.solvers.solution import IKSolution
from ikgrad.solvers.solve import solve_ik

NAMES = ("I-1", "1-2", "2-3", "3-4", "4-5", "5-6", "6-I")
JOINT_COLUMNS = tuple(f"theta{k}_deg" for k in range(1, 7))


@dataclass(frozen=True)
class Motion:
    """One motion, solved.

    Attributes:
        name: such as ``"I-1"``.
        T_target: (4, 4) goal pose [m].
        q_start: (6,) joint values I [rad].
        q: (6,) R_1, inside the joint ranges after eq. (12) [rad].
        q_rounded: (6,) R_2 [rad].
        path: (k, 6) every iterate from I on, before eq. (12) [rad].
        errors: (k,) E at every iterate, the plain sum of squares.
        iterations: evaluations of E.
        converged: the pose is reached, judged by forward kinematics.
        reason: why the solver stopped.
        seconds: wall time of the solution.
    """

    name: str
    T_target: Tensor
    q_start: Tensor
    q: Tensor
    q_rounded: Tensor
    path: Tensor
    errors: Tensor
    iterations: int
    converged: bool
    reason: str
    seconds: float


def start_configuration() -> Tensor:
    """(6,) joint values of "motion 0" [rad], Table 3."""
    return torch.tensor(numbers(find_row("apps_table3", quantity="I"), *JOINT_COLUMNS), dtype=torch.float64).deg2rad()


def goal_poses(robot: Robot) -> Tensor:
    """(7, 4, 4) goals of the seven motions: positions of Table 2 (x corrected), rotations of eq. (22).

    Eq. (22) holds for P_1 to P_6. The rotation at P_I is not printed; the one of the start configuration gives the
    printed joint values of motion 6-I, so that is used.
    """
    T = torch.eye(4, dtype=torch.float64).repeat(7, 1, 1)
    T[:, :3, :3] = torch.tensor([[0.0, 0, -1], [0, -1, 0], [-1, 0, 0]], dtype=torch.float64)
    T[-1, :3, :3] = forward_kinematics(robot, start_configuration())[:3, :3]
    points = read_table("apps_table2")[1:]  # the first row is where the experiment starts
    xyz = [numbers(row, "x_corrected_m", "y_printed_m", "z_printed_m") for row in points]
    T[:, :3, 3] = torch.tensor(xyz, dtype=torch.float64)
    return T


def entry_error(T: Tensor, T_target: Tensor) -> Tensor:
    """E = sum of the squared differences of the upper three rows of two poses: (..., 4, 4) -> (...).

    The plain sum; eq. (11) has half of it. Metres and rotation entries are added as they are.
    """
    return (T_target - T)[..., :3, :].square().sum((-2, -1))


def round_joints(q: Tensor) -> Tensor:
    """Joint values rounded to 0.01 deg, how the paper makes R_2 from R_1 [rad]."""
    return torch.round(q.rad2deg(), decimals=2).deg2rad()


def solve_motions(
    solver: Apps, *, tol_pos: float, tol_rot: float, progress: Callable[[str], None] | None = None
) -> list[Motion]:
    """The seven motions in order, each from the rounded joint values that the one before reached.

    Args:
        solver: settings of the algorithm.
        tol_pos: position error below which a goal counts as reached [m].
        tol_rot: rotation error below which a goal counts as reached [rad].
        progress: called with a label before each motion.
    """
    robot, q_start = load_robot("kr210"), start_configuration()
    solved: list[tuple[Tensor, IKSolution, float]] = []
    T_goals = goal_poses(robot)
    for name, T_target in zip(NAMES, T_goals, strict=True):
        if progress:
            progress(f"motion {name}")
        begin = time.perf_counter()
        solution = solve_ik(robot, T_target, q0=q_start, solver=solver, tol_pos=tol_pos, tol_rot=tol_rot)
        solved.append((q_start, solution, time.perf_counter() - begin))
        q_start = round_joints(solution.q)
    paths = descend(robot, T_goals, torch.stack([start for start, _, _ in solved]), solver)
    return [
        Motion(
            name=name,
            T_target=T_target,
            q_start=start,
            q=solution.q,
            q_rounded=round_joints(solution.q),
            path=path,
            errors=entry_error(forward_kinematics(robot, path), T_target),
            iterations=int(solution.steps),
            converged=bool(solution.success),
            reason=str(solution.reason),
            seconds=seconds,
        )
        for name, T_target, (start, solution, seconds), path in zip(NAMES, T_goals, solved, paths, strict=True)
    ]
