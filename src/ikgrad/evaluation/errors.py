"""Errors of joint values against wanted poses, as percentiles and shares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import DataError, ShapeError
from ikgrad.kinematics import check_poses, check_q, plain_forward_kinematics
from ikgrad.robot import Robot
from ikgrad.rotations import rotation_angle

CLOSE = (1e-3, 1e-2)  # [m], [rad]: good enough to hand over to a controller
EXACT = (1e-6, 1e-6)  # [m], [rad]: the solver's tolerance
_QUANTILES = (0.5, 0.95, 0.999)


@dataclass(frozen=True)
class Errors:
    """Errors over many rows.

    Attributes:
        position_mm: median, 95th and 99.9th percentile of the distance to the wanted position [mm].
        rotation_deg: the same of the angle to the wanted orientation [deg].
        mean_position_mm: mean distance [mm].
        mean_rotation_deg: mean angle [deg].
        inside: share of rows with all joints inside the limits.
        close: share inside the limits and within 1 mm and 0.01 rad.
        exact: share inside the limits and within 1e-6 m and 1e-6 rad.
    """

    position_mm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]
    mean_position_mm: float
    mean_rotation_deg: float
    inside: float
    close: float
    exact: float


class RowErrors(NamedTuple):
    """Errors row by row.

    Attributes:
        position: (N,) distance to the wanted position [m]; infinite where the answer is not finite.
        rotation: (N,) angle to the wanted orientation [rad], likewise.
        inside: (N,) bool: all joints inside the limits.
    """

    position: Tensor
    rotation: Tensor
    inside: Tensor

    def within(self, tol_pos: float, tol_rot: float) -> Tensor:
        """(N,) bool: inside the limits, and both errors within tolerance [m], [rad]."""
        return self.inside & (self.position <= tol_pos) & (self.rotation <= tol_rot)


def row_errors(robot: Robot, q: Tensor, T_target: Tensor) -> RowErrors:
    """Errors of joint values row by row, by forward kinematics in float64 and plain torch operations.

    None of the compiled kernels that may have found ``q`` takes part. A row that is not finite counts as infinitely
    far off.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) answers [rad or m].
        T_target: (..., 4, 4) wanted poses [m], of the same rows.

    Raises:
        ShapeError: shapes do not fit.
        DataError: no rows.
    """
    check_q(robot, q)
    check_poses("T_target", T_target)
    if q.shape[:-1] != T_target.shape[:-2]:
        raise ShapeError(f"q and T_target must have the same rows, got {tuple(q.shape)} and {tuple(T_target.shape)}")
    q, target = q.detach().double().reshape(-1, robot.dof), T_target.detach().double().reshape(-1, 4, 4)
    if len(q) == 0:
        raise DataError("there are no rows to measure")
    T = plain_forward_kinematics(robot.detach(), q)
    position = (target[:, :3, 3] - T[:, :3, 3]).norm(dim=-1).nan_to_num(torch.inf)
    rotation = rotation_angle(target[:, :3, :3] @ T[:, :3, :3].mT).nan_to_num(torch.inf)
    inside = ((q >= robot.q_min.to(q)) & (q <= robot.q_max.to(q))).all(dim=-1)
    return RowErrors(position, rotation, inside)


def measure(robot: Robot, q: Tensor, T_target: Tensor) -> Errors:
    """Errors of joint values as percentiles and shares; see `row_errors` for how they are measured.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) answers [rad or m].
        T_target: (..., 4, 4) wanted poses [m], of the same rows.

    Raises:
        ShapeError: shapes do not fit.
        DataError: no rows.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> q = ik.sample_configurations(robot, 50, seed=0)
        >>> measure(robot, q, ik.forward_kinematics(robot, q)).exact
        1.0
    """
    rows = row_errors(robot, q, T_target)
    return Errors(
        position_mm=_percentiles(rows.position * 1e3),
        rotation_deg=_percentiles(rows.rotation.rad2deg()),
        mean_position_mm=float(rows.position.mean() * 1e3),
        mean_rotation_deg=float(rows.rotation.mean().rad2deg()),
        inside=_share(rows.inside),
        close=_share(rows.within(*CLOSE)),
        exact=_share(rows.within(*EXACT)),
    )


def _percentiles(values: Tensor) -> tuple[float, float, float]:
    """Of sorted values, without interpolation, so that an infinite one stays where it is."""
    ranked = values.sort().values
    median, high, highest = (float(ranked[min(len(ranked) - 1, int(share * len(ranked)))]) for share in _QUANTILES)
    return median, high, highest


def _share(good: Tensor) -> float:
    return float(good.double().mean())


__all__ = ["CLOSE", "EXACT", "Errors", "RowErrors", "measure", "row_errors"]
