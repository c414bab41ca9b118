"""The arm of the paper, its five printed points, and its joints' places in space.

One unit of length of the paper is one metre here. Only tf, the end time, is ours: the paper does not print it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.collision import link_segments
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.printed import Row, find_row, numbers, read_table
from ikgrad.robot import Robot, load_robot
from ikgrad.trajectory import Trajectory, via_point_trajectory

REACH = 30.0
VIA_TIMES = (2.0, 5.0)  # [s]
DESTINATIONS = ("destination_1", "destination_2")
_JOINTS = ("theta1_deg", "theta2_deg", "theta3_deg", "theta4_deg")
_PRINTED = ("x_printed_unit", "y_printed_unit", "z_printed_unit")


@dataclass(frozen=True)
class PointRow:
    """A point of Table 1 against forward kinematics.

    Attributes:
        name: as in the table.
        joints_deg: (4,) printed joint angles.
        printed: (3,) printed position of the hand.
        corrected: (3,) the same with y = 16.67 put right.
        computed: (3,) by forward kinematics.
    """

    name: str
    joints_deg: tuple[float, ...]
    printed: tuple[float, ...]
    corrected: tuple[float, ...]
    computed: tuple[float, ...]

    @property
    def off(self) -> float:
        """Largest difference of a coordinate from the corrected table."""
        return _largest(self.computed, self.corrected)

    @property
    def printed_off(self) -> float:
        """Largest difference of a coordinate from the table as printed."""
        return _largest(self.computed, self.printed)


def arm() -> Robot:
    """The arm."""
    return load_robot("arm4")


def point(name: str) -> Tensor:
    """(4,) joint values of a point of Table 1 [rad].

    Example:
        >>> point("via_2").rad2deg().round().tolist()
        [30.0, 40.0, 50.0, 60.0]
    """
    return torch.tensor(numbers(find_row("trajectory_table1", point=name), *_JOINTS), dtype=torch.float64).deg2rad()


def printed_destinations() -> Tensor:
    """(2, 4) joint values of both destinations [rad]."""
    return torch.stack([point(name) for name in DESTINATIONS])


def trajectories(destinations: Tensor, tf: float) -> Trajectory:
    """From the start through both via points to destinations, the paper's 4-3-4 curves from rest to rest.

    Args:
        destinations: (..., 4) [rad]
        tf: end time [s].

    Example:
        >>> trajectories(printed_destinations(), 8.0).position(2.0).rad2deg().round().tolist()
        [[10.0, 20.0, 30.0, 40.0], [10.0, 20.0, 30.0, 40.0]]
    """
    before = torch.stack([point(name) for name in ("start", "via_1", "via_2")])
    before = before.to(destinations).expand(*destinations.shape[:-1], 3, 4)
    return via_point_trajectory(torch.cat([before, destinations[..., None, :]], dim=-2), [0.0, *VIA_TIMES, tf])


def joint_places(q: Tensor) -> Tensor:
    """(..., 3, 3) positions of joint 3, joint 4 and the hand; joints 1 and 2 stay at the origin.

    Example:
        >>> joint_places(torch.zeros(4))[:, 0].tolist()
        [10.0, 20.0, 30.0]
    """
    return link_segments(arm(), q)[..., 1, :]


def links_through(places: Tensor) -> Tensor:
    """(..., 3, 2, 3) the three links from (..., 3, 3) joint 3, joint 4 and hand: each joined to the one before."""
    origin = torch.zeros_like(places[..., :1, :])
    return torch.stack([torch.cat([origin, places[..., :-1, :]], dim=-2), places], dim=-2)


def check_points() -> tuple[PointRow, ...]:
    """The four points whose positions are printed."""
    return tuple(_point_row(row) for row in read_table("trajectory_table1") if row["x_printed_unit"])


def fitted_lengths(names: tuple[str, ...] = ("via_1", "via_2", "destination_1")) -> tuple[float, ...]:
    """(3,) link lengths, not printed, by least squares from printed positions, which are linear in them.

    Example:
        >>> [round(length, 3) for length in fitted_lengths()]
        [9.993, 10.006, 9.999]
    """
    rows, positions = [], []
    for name in names:
        # Coordinates are linear in the lengths: link k counts with its direction.
        ends = links_through(joint_places(point(name)))
        rows.append((ends[:, 1] - ends[:, 0]).mT / 10.0)
        positions.append(torch.tensor(numbers(find_row("trajectory_table1", point=name), *_PRINTED)).double())
    found = torch.linalg.lstsq(torch.cat(rows), torch.cat(positions)[:, None]).solution
    return tuple(found.flatten().tolist())


def _point_row(row: Row) -> PointRow:
    x, y, z = numbers(row, *_PRINTED)
    (right,) = numbers(row, "y_corrected_unit")
    T = forward_kinematics(arm(), point(row["point"]))
    return PointRow(row["point"], numbers(row, *_JOINTS), (x, y, z), (x, right, z), tuple(T[:3, 3].tolist()))


def _largest(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


__all__ = [
    "DESTINATIONS",
    "REACH",
    "VIA_TIMES",
    "PointRow",
    "arm",
    "check_points",
    "fitted_lengths",
    "joint_places",
    "links_through",
    "point",
    "printed_destinations",
    "trajectories",
]
