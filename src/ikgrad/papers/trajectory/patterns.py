"""What the networks learn from and are judged by: inputs and outputs along trajectories to many destinations."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import UnknownNameError
from ikgrad.papers.trajectory.arm import joint_places, printed_destinations, trajectories

# Final joint angles of the training set [deg]; not printed. Both printed destinations lie inside.
LOW_DEG, HIGH_DEG = (20.0, 10.0, 20.0, 10.0), (70.0, 40.0, 30.0, 40.0)
TRAIN_INSTANTS, TEST_INSTANTS = 41, 81

# Which place of the arm a network answers with, and from which joint angles besides the time: its own destination,
# or the present angles of the joints before.
TARGETS = {"hand": 4, "joint 3": 2, "joint 4": 3}


class Patterns(NamedTuple):
    """Inputs and outputs of one network.

    Attributes:
        x: (..., D, T, k) the time [s], then the angles [deg]; D destinations, T instants.
        y: (..., D, T, 3) position.
    """

    x: Tensor
    y: Tensor


def random_destinations(count: int, *, seed: int) -> Tensor:
    """(count, 4) joint values, uniform in the box [rad].

    Example:
        >>> random_destinations(2, seed=0).rad2deg().round().tolist()
        [[69.0, 31.0, 25.0, 38.0], [52.0, 34.0, 22.0, 21.0]]
    """
    low, high = torch.tensor([LOW_DEG, HIGH_DEG], dtype=torch.float64).deg2rad()
    unit = torch.rand(count, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return low + unit * (high - low)


def along(destinations: Tensor, target: str, tf: float, instants: int) -> Patterns:
    """Patterns at instants spread evenly over the whole time.

    The hand is answered from the time and the *final* joint angles, as the paper has it: the network has to know the
    trajectory too. Joint 3 is answered from the time, theta_1(t) and theta_2(t), joint 4 from theta_3(t) besides.

    Args:
        destinations: (..., D, 4) [rad]
        target: ``"hand"``, ``"joint 3"`` or ``"joint 4"``.
        tf: end time [s].
        instants: T.

    Raises:
        UnknownNameError: no such target.
    """
    if target not in TARGETS:
        raise UnknownNameError("target", target, TARGETS)
    t = torch.linspace(0.0, tf, instants, dtype=torch.float64)
    q = trajectories(destinations, tf).position(t)  # (..., D, T, 4)
    known = destinations[..., None, :].expand_as(q) if target == "hand" else q
    angles = known[..., : TARGETS[target]].rad2deg()
    x = torch.cat([t[:, None].expand(*angles.shape[:-1], 1), angles], dim=-1)
    place = {"joint 3": 0, "joint 4": 1, "hand": 2}[target]
    return Patterns(x, joint_places(q)[..., place, :])


def unseen(target: str, tf: float) -> Patterns:
    """Patterns along both printed destinations, which no training set holds."""
    return along(printed_destinations(), target, tf, TEST_INSTANTS)


__all__ = ["TARGETS", "TEST_INSTANTS", "TRAIN_INSTANTS", "Patterns", "along", "random_destinations", "unseen"]
