"""Tables 3 to 6 of the paper: our numbers beside the printed ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.apps.experiment import JOINT_COLUMNS, Motion
from ikgrad.papers.printed import find_row, numbers, read_table
from ikgrad.robot import load_robot

Values = tuple[float, ...]

# Misprint 4: theta_1 of R_1 in motion I-1; the right value is motion 5-6's with the other sign.
CORRECTED_JOINTS = {("I-1", "R_1"): {0: -20.0955}}


@dataclass(frozen=True)
class JointRow:
    """A column of Table 3 (R_1 or R_2 of one motion); six values each [deg]."""

    motion: str
    quantity: str
    ours_deg: Values
    printed_deg: Values
    corrected_deg: Values
    difference_deg: Values  # ours - corrected


@dataclass(frozen=True)
class PositionRow:
    """A column of Table 4 (T, R_1 or R_2 of one motion); three values each."""

    motion: str
    quantity: str
    ours_m: Values
    printed_m: Values
    difference_mm: Values


@dataclass(frozen=True)
class ErrorRow:
    """A column of Table 5: MAE_1, MAE_2, MAE_S of one motion [mm]."""

    motion: str
    ours_mm: Values  # from our positions, rounded to 0.01 mm as Table 4 is
    unrounded_mm: Values  # from our positions as they are
    from_table4_mm: Values  # the same arithmetic on the printed Table 4
    printed_mm: Values


@dataclass(frozen=True)
class ComparisonRow:
    """A row of Table 6: APPS on one motion."""

    motion: str
    iterations: int | None  # None: not converged
    printed_iterations: int
    mae_mm: float
    printed_mae_mm: float
    seconds: float
    printed_seconds: float


@dataclass(frozen=True)
class Tables:
    """Tables 3 to 6."""

    table3: tuple[JointRow, ...]
    table4: tuple[PositionRow, ...]
    table5: tuple[ErrorRow, ...]
    table6: tuple[ComparisonRow, ...]


def all_tables(motions: Sequence[Motion]) -> Tables:
    """Tables 3 to 6 of the seven motions."""
    return Tables(table3(motions), table4(motions), table5(motions), table6(motions))


def table3(motions: Sequence[Motion]) -> tuple[JointRow, ...]:
    """Joint values R_1 and R_2, corrected in one place (misprint 4)."""
    rows = []
    for motion in motions:
        for quantity, q in (("R_1", motion.q), ("R_2", motion.q_rounded)):
            ours = tuple(q.rad2deg().tolist())
            printed = numbers(find_row("apps_table3", motion=motion.name, quantity=quantity), *JOINT_COLUMNS)
            fix = CORRECTED_JOINTS.get((motion.name, quantity), {})
            right = tuple(fix.get(k, value) for k, value in enumerate(printed))
            difference = tuple(a - b for a, b in zip(ours, right, strict=True))
            rows.append(JointRow(motion.name, quantity, ours, printed, right, difference))
    return tuple(rows)


def table4(motions: Sequence[Motion]) -> tuple[PositionRow, ...]:
    """Tool positions: the goal T and those of R_1 and R_2 by forward kinematics."""
    rows = []
    for motion in motions:
        for quantity, xyz in _positions(motion).items():
            printed = printed_position(motion.name, quantity)
            difference = tuple(((xyz - printed) * 1e3).tolist())
            rows.append(PositionRow(motion.name, quantity, tuple(xyz.tolist()), tuple(printed.tolist()), difference))
    return tuple(rows)


def table5(motions: Sequence[Motion]) -> tuple[ErrorRow, ...]:
    """Mean absolute position errors; the printed ones follow from the rounded positions of Table 4."""
    rows = []
    for motion in motions:
        xyz = _positions(motion)
        rounded = {quantity: np.round(value, 5) for quantity, value in xyz.items()}
        printed = {quantity: printed_position(motion.name, quantity) for quantity in xyz}
        row = numbers(find_row("apps_table5", motion=motion.name), "mae1_mm", "mae2_mm", "maeS_mm")
        exact = mean_errors_mm(xyz)
        two = [two_decimals(mean_errors_mm(positions)) for positions in (rounded, printed)]
        rows.append(ErrorRow(motion.name, two[0], (*exact, sum(exact)), two[1], row))
    return tuple(rows)


def table6(motions: Sequence[Motion]) -> tuple[ComparisonRow, ...]:
    """Iterations, position error and time of APPS; the printed times belong to MATLAB on a 2.67 GHz i5."""
    rows = []
    for motion in motions:
        printed = find_row("apps_table6", algorithm="APPS", motion=motion.name)
        mae, seconds = numbers(printed, "mae_mm", "time_s")
        rows.append(
            ComparisonRow(
                motion.name,
                motion.iterations if motion.converged else None,
                int(printed["iterations"]),
                mean_errors_mm(_positions(motion))[0],
                mae,
                motion.seconds,
                seconds,
            )
        )
    return tuple(rows)


def printed_newton() -> dict[str, tuple[float | None, int | None]]:
    """Newton-Raphson in Table 6: MAE [mm] and iterations by motion; None where the paper has FALSE."""
    rows = (row for row in read_table("apps_table6") if row["algorithm"] == "NR")
    return {
        row["motion"]: (None, None) if row["mae_mm"] == "FALSE" else (float(row["mae_mm"]), int(row["iterations"]))
        for row in rows
    }


def printed_position(motion: str, quantity: str) -> np.ndarray:
    """(3,) a position of Table 4 [m]."""
    return np.array(numbers(find_row("apps_table4", motion=motion, quantity=quantity), "x_m", "y_m", "z_m"))


def mean_errors_mm(xyz: dict[str, np.ndarray]) -> tuple[float, float]:
    """MAE_1 = mean |R_1 - T| and MAE_2 = mean |R_2 - R_1| over x, y, z [mm]."""
    first = np.abs(xyz["R_1"] - xyz["T"]).mean() * 1e3
    second = np.abs(xyz["R_2"] - xyz["R_1"]).mean() * 1e3
    return float(first), float(second)


def two_decimals(errors: tuple[float, float]) -> tuple[float, float, float]:
    """MAE_1, MAE_2 and their sum MAE_S (eq. 23) as printed: the sum is of the rounded values."""
    first, second = (round(value, 2) for value in errors)
    return first, second, round(first + second, 2)


def _positions(motion: Motion) -> dict[str, np.ndarray]:
    q = torch.stack([motion.q, motion.q_rounded])
    xyz = forward_kinematics(load_robot("kr210"), q)[:, :3, 3].numpy()
    return {"T": motion.T_target[:3, 3].numpy(), "R_1": xyz[0], "R_2": xyz[1]}
