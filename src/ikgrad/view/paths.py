"""The paths of the four studies, by name: nothing is trained, all of them are computed when asked for."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.errors import ConfigError, UnknownNameError
from ikgrad.robot import Robot, load_robot
from ikgrad.view.motion import Motion

BETWEEN = 30  # rows drawn between two printed poses of the PUMA study
INSTANTS = 241  # of a via-point trajectory: 30 a second


class Path(NamedTuple):
    """One path.

    Attributes:
        robot: built-in name of the arm that it belongs to.
        what: in words.
        joints: makes the (k, n) joints.
        spheres: makes the obstacles of the study, if it has some.
    """

    robot: str
    what: str
    joints: Callable[[], Tensor]
    spheres: Callable[[], Spheres] | None = None


def named_motion(name: str, robot: Robot) -> Motion:
    """A study's path as a motion.

    Args:
        name: a key of `PATHS`.
        robot: must be the very arm of the study.

    Raises:
        UnknownNameError: no such path.
        ConfigError: another robot.

    Example:
        >>> from ikgrad.robot import load_robot
        >>> len(named_motion("puma", load_robot("puma560")).q)
        241
    """
    path = find_path(name)
    if robot.fingerprint != load_robot(path.robot).fingerprint:
        raise ConfigError(
            f"the path '{name}' is of the built-in robot '{path.robot}', not of '{robot.name}' as given; "
            "leave --robot, --base and --tip out"
        )
    return Motion(f"{name}, {path.what}", path.joints())


def find_path(name: str) -> Path:
    """The entry of a name, or the nearest match in an error."""
    if name not in PATHS:
        raise UnknownNameError("path", name, PATHS)
    return PATHS[name]


def _apps() -> Tensor:
    """All iterates of the seven motions, each from the rounded joints of Table 3 where the one before ended."""
    from ikgrad.papers.apps.descent import descend
    from ikgrad.papers.apps.experiment import JOINT_COLUMNS, goal_poses
    from ikgrad.papers.printed import numbers, read_table
    from ikgrad.solvers.apps import Apps

    robot, rows = load_robot("kr210"), read_table("apps_table3")
    starts = [numbers(row, *JOINT_COLUMNS) for row in rows if row["quantity"] in ("I", "R_2")][:-1]
    q0 = torch.tensor(starts, dtype=torch.float64).deg2rad()
    return torch.cat(descend(robot, goal_poses(robot), q0, Apps.reproduces()))


def _puma() -> Tensor:
    """The nine poses of Table 1, corrected, with straight lines between their joints."""
    from ikgrad.papers.puma.path import path_data

    q = path_data("corrected").q
    part = torch.arange(BETWEEN, dtype=torch.float64)[:, None] / BETWEEN
    rows = [a + part * (b - a) for a, b in itertools.pairwise(q)]
    return torch.cat([*rows, q[-1:]])


def _denso(kind: str) -> Callable[[], Tensor]:
    def joints() -> Tensor:
        from ikgrad.papers.denso.arm import tool_down_ik
        from ikgrad.papers.denso.paths import path_points

        return tool_down_ik(path_points(kind, lap=600))

    return joints


def _trajectory(destination: int) -> Callable[[], Tensor]:
    def joints() -> Tensor:
        from ikgrad.config import TrajectoryConfig
        from ikgrad.papers.trajectory.arm import printed_destinations, trajectories

        tf = TrajectoryConfig().tf
        t = torch.linspace(0.0, tf, INSTANTS, dtype=torch.float64)
        return trajectories(printed_destinations()[destination], tf).position(t)

    return joints


def _obstacle() -> Spheres:
    from ikgrad.papers.trajectory.obstacle import obstacle

    return obstacle()


PATHS: dict[str, Path] = {
    "apps": Path("kr210", "the iterates of its seven motions", _apps),
    "puma": Path("puma560", "its nine poses", _puma),
    "denso": Path("denso_vp6242", "helix", _denso("helix")),
    "denso-square": Path("denso_vp6242", "square", _denso("square")),
    "denso-eight": Path("denso_vp6242", "figure eight", _denso("figure eight")),
    "trajectory": Path("arm4", "to destination 1, with the obstacle", _trajectory(0), _obstacle),
    "trajectory-2": Path("arm4", "to destination 2, with the obstacle", _trajectory(1), _obstacle),
}


__all__ = ["PATHS", "Path", "find_path", "named_motion"]
