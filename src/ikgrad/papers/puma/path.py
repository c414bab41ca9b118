"""The path of Table 1, as printed and corrected, and the evidence for every correction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.printed import numbers, read_table
from ikgrad.robot import load_robot

Values = tuple[float, ...]

JOINT_COLUMNS = tuple(f"theta{k}_deg" for k in range(1, 7))
POSITION_COLUMNS = ("px_mm", "py_mm", "pz_mm")
TABLES = {"printed": "puma_table1", "corrected": "puma_table1_corrected"}

# What rounding allows: joints to 0.005 deg move the wrist by up to 0.08 mm, their sum is off by up to 0.015 deg.
POSITION_TOLERANCE_MM = 0.08
SUM_TOLERANCE_DEG = 0.0151


class PathData(NamedTuple):
    """Nine poses: where the wrist is, and the joint angles that put it there.

    Attributes:
        name: ``"printed"`` or ``"corrected"``.
        p: (9, 3) positions [m].
        q: (9, 6) joint angles [rad].
    """

    name: str
    p: Tensor
    q: Tensor


@dataclass(frozen=True)
class PathRow:
    """One row of Table 1 against forward kinematics.

    Attributes:
        row: 1 to 9.
        residual_mm: FK of the printed joints less the printed position.
        angle_sum_deg: theta2 + theta3 + theta5, 180 where the tool points straight down.
        corrected_residual_mm: the same residual after the corrections.
        corrected_sum_deg: the same sum after them.
        changes: the corrections, in words; empty where the row is right.
        right: whether the printed row agrees with FK and with the sum, within rounding.
    """

    row: int
    residual_mm: Values
    angle_sum_deg: float
    corrected_residual_mm: Values
    corrected_sum_deg: float
    changes: str
    right: bool


def path_data(name: str) -> PathData:
    """The nine poses, ``"printed"`` or ``"corrected"``.

    Example:
        >>> path_data("printed").q.shape
        torch.Size([9, 6])
    """
    rows = read_table(TABLES[name])
    p = torch.tensor([numbers(row, *POSITION_COLUMNS) for row in rows], dtype=torch.float64) / 1000.0
    q = torch.tensor([numbers(row, *JOINT_COLUMNS) for row in rows], dtype=torch.float64).deg2rad()
    return PathData(name, p, q)


def residuals_mm(data: PathData) -> Tensor:
    """(9, 3) FK of the joints less the position [mm]."""
    T = forward_kinematics(load_robot("puma560"), data.q)
    return 1000.0 * (T[:, :3, 3] - data.p)


def angle_sums_deg(data: PathData) -> Tensor:
    """(9,) theta2 + theta3 + theta5 [deg]."""
    return data.q[:, [1, 2, 4]].sum(-1).rad2deg()


def check_path() -> tuple[PathRow, ...]:
    """Table 1 row by row, as printed and as corrected."""
    printed, corrected = path_data("printed"), path_data("corrected")
    before, after = residuals_mm(printed), residuals_mm(corrected)
    sums, corrected_sums = angle_sums_deg(printed), angle_sums_deg(corrected)
    rows = []
    for k, row in enumerate(read_table(TABLES["corrected"])):
        right = before[k].abs().max() <= POSITION_TOLERANCE_MM and abs(sums[k] - 180.0) <= SUM_TOLERANCE_DEG
        rows.append(
            PathRow(
                int(row["row"]),
                tuple(before[k].tolist()),
                sums[k].item(),
                tuple(after[k].tolist()),
                corrected_sums[k].item(),
                row["changes"],
                bool(right),
            )
        )
    return tuple(rows)


__all__ = ["PathData", "PathRow", "angle_sums_deg", "check_path", "path_data", "residuals_mm"]
