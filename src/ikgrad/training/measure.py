"""Test errors of an inverter: in the joints that it was trained on, and where its answers put the tip."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.data import Samples
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.networks import Inverter
from ikgrad.training.inverters import answers


@dataclass(frozen=True)
class TestErrors:
    """Errors over some rows, their true present joints given.

    Attributes:
        rows: how many.
        joint_mse: mean of ``(q - d)^2`` over rows and joints [rad^2 or m^2].
        position_mm: median, 95th percentile and largest distance of the tip from its target [mm].
        rotation_deg: the same of the angle between the orientations [deg].
    """

    __test__ = False  # not for pytest

    rows: int
    joint_mse: float
    position_mm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]


def measure(inverter: Inverter, rows: Samples) -> TestErrors | None:
    """Errors of the inverter, by forward kinematics in float64; None without rows."""
    if len(rows.q) == 0:
        return None
    q = answers(inverter, rows).to("cpu", torch.float64)
    error = pose_error(forward_kinematics(inverter.robot, q), rows.T)
    position, rotation = 1000.0 * error[:, :3].norm(dim=-1), error[:, 3:].norm(dim=-1).rad2deg()
    mse = (q - rows.q).square().mean().item()
    return TestErrors(len(q), mse, _spread(position), _spread(rotation))


def _spread(values: Tensor) -> tuple[float, float, float]:
    """Median, 95th percentile and maximum; `torch.quantile` has a limit of 16 million values, sorting has none."""
    ordered = values.sort().values
    ranks = [round(share * (len(ordered) - 1)) for share in (0.5, 0.95, 1.0)]
    low, high, worst = ordered[ranks].tolist()
    return low, high, worst


__all__ = ["TestErrors", "measure"]
