"""The misprints of the paper, each with its evidence recomputed from the robot and the printed tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics, pose_and_jacobian
from ikgrad.papers.apps.compare import DescentRow
from ikgrad.papers.apps.experiment import JOINT_COLUMNS, Motion, entry_error
from ikgrad.papers.apps.tables import CORRECTED_JOINTS, mean_errors_mm, printed_position, two_decimals
from ikgrad.papers.printed import find_row, numbers, read_table
from ikgrad.papers.record import Erratum
from ikgrad.robot import load_robot


def errata(
    motions: Sequence[Motion], literal: Sequence[DescentRow], printed: Sequence[DescentRow]
) -> tuple[Erratum, ...]:
    """All misprints; ``literal`` and ``printed`` are the runs with eq. (20) and the settings as the paper has them."""
    return (
        _update_rule(literal),
        _settings(motions, printed),
        _table2(),
        _theta1(),
        Erratum(
            5,
            "Table 3, I-1, R_1, theta_6",
            "-147.3760",
            "-147.3755",
            f"ours: {motions[0].q[5].rad2deg():.5f}; every other value agrees to 2e-4 deg",
        ),
        _joint_change(),
        Erratum(
            7,
            "text on Table 6",
            "Newton-Raphson fails on 3-4 and 6-I",
            "on I-1 and 5-6",
            "FALSE stands at I-1 and 5-6 in Table 6; an earlier sentence agrees with the table",
        ),
        Erratum(8, "Table 6", 'motion "I-2"', "1-2", "the sequence of motions"),
        _mean_time(),
        _rounded_to_zero(),
        _wrap(),
        _jacobian(motions[0]),
        Erratum(
            13,
            "table headings in text copies",
            '"1-1", "6-1", "P_1" twice',
            "I-1, 6-I, P_I",
            "the letter I was lost in text extraction; no mistake of the authors",
        ),
    )


def printed_joints(motion: str, quantity: str, *, corrected: bool = True) -> Tensor:
    """(6,) joint values of Table 3 [rad]."""
    values = list(numbers(find_row("apps_table3", motion=motion, quantity=quantity), *JOINT_COLUMNS))
    if corrected:
        for k, value in CORRECTED_JOINTS.get((motion, quantity), {}).items():
            values[k] = value
    return torch.tensor(values, dtype=torch.float64).deg2rad()


def _update_rule(literal: Sequence[DescentRow]) -> Erratum:
    reached = sum(row.iterations is not None for row in literal)
    stuck = sum(not row.joints_moved for row in literal)
    best = min(row.E_best for row in literal)
    return Erratum(
        1,
        "eq. (20)",
        "no step where |dtheta| <= dtheta_th",
        "step dtheta there",
        f"as printed: {reached} of {len(literal)} runs converge, best E {best:.1e}, {stuck} never move; "
        "the clip gives the printed counts",
    )


def _settings(motions: Sequence[Motion], printed: Sequence[DescentRow]) -> Erratum:
    E = [float(entry_error(_fk(printed_joints(m.name, "R_1")), m.T_target)) / 2 for m in motions]
    reached = sum(row.iterations is not None for row in printed)
    return Erratum(
        2,
        "settings",
        "eta 0.01, E0 1e-8",
        "eta 0.1, E0 1e-9 on the plain sum (0.2, 5e-10 on the half sum)",
        f"as printed: {reached} of {len(printed)} motions converge in {printed[0].max_steps} iterations; "
        f"E (half sum) at the printed R_1 is {min(E):.1e} to {max(E):.1e}, far below 1e-8",
    )


def _table2() -> Erratum:
    x = [float(_fk(printed_joints(name, "R_1"))[0, 3]) for name in ("I-1", "5-6")]
    return Erratum(
        3,
        "Table 2, P_1 and P_6",
        "X = 1.9845",
        "X = 1.9485",
        f"FK of Table 3: {x[0]:.4f} and {x[1]:.4f}; Table 4 has 1.9485",
    )


def _theta1() -> Erratum:
    rows = []
    for corrected in (False, True):
        T = _fk(printed_joints("I-1", "R_1", corrected=corrected))
        goal = torch.eye(4, dtype=torch.float64)
        goal[:3, :3] = torch.tensor([[0.0, 0, -1], [0, -1, 0], [-1, 0, 0]])
        goal[:3, 3] = torch.from_numpy(printed_position("I-1", "T"))
        miss = abs(float(T[1, 3]) - printed_position("I-1", "R_1")[1]) * 1e3
        rows.append((miss, float(entry_error(T, goal)) / 2))
    (miss, E), (miss_right, E_right) = rows
    return Erratum(
        4,
        "Table 3, I-1, R_1, theta_1",
        "-20.0995",
        "-20.0955",
        f"as printed y is {miss:.2f} mm off Table 4 and E {E:.1e}; corrected {miss_right:.3f} mm and {E_right:.1e}",
    )


def _joint_change() -> Erratum:
    before, after = (numbers(find_row("apps_table3", motion=m, quantity=k), "theta6_deg")[0] for m, k in _AROUND_34)
    return Erratum(
        6,
        "text on 3-4, last joint change",
        find_row("apps_text_joint_changes", motion="3-4")["d_theta6_printed_deg"],
        f"{after - before:.4f}",
        f"Table 3: {after:.4f} - ({before:.2f})",
    )


_AROUND_34 = (("2-3", "R_2"), ("3-4", "R_1"))


def _mean_time() -> Erratum:
    times = [float(row["time_s"]) for row in read_table("apps_table6") if row["algorithm"] == "NR" and row["time_s"]]
    mean = np.mean(times)
    return Erratum(9, "mean time of Newton-Raphson", "22.7067 s", f"{mean:.4f} s", "mean of the column of Table 6")


def _rounded_to_zero() -> Erratum:
    """Not only MAE_1 (0 for 0.0068 mm): the y of R_1 in Table 4 is 0 too, and MAE_2 follows from that 0."""
    table4 = {key: printed_position("6-I", key) for key in ("T", "R_1", "R_2")}
    xyz = table4 | {key: _fk(printed_joints("6-I", key))[:3, 3].numpy() for key in ("R_1", "R_2")}
    y, exact = xyz["R_1"][1], mean_errors_mm(xyz)
    first, second, _ = two_decimals(mean_errors_mm({key: np.round(value, 5) for key, value in xyz.items()}))
    chained = two_decimals(mean_errors_mm(table4))
    return Erratum(
        10,
        "Table 4, 6-I, R_1, y; Table 5, 6-I",
        "y = 0; MAE_1 = 0, MAE_2 = 0.05",
        f"y = {y:.5f}; MAE_1 = {first:.2f}, MAE_2 = {second:.2f}",
        f"FK of the printed R_1 gives y = {y * 1e3:.3f} mm; unrounded MAE {exact[0]:.4f} and {exact[1]:.4f} mm; "
        f"the printed {chained[0]:.2f} and {chained[1]:.2f} follow from y = 0",
    )


def _wrap() -> Erratum:
    low, high = (limit[1].rad2deg() for limit in (load_robot("kr210").q_min, load_robot("kr210").q_max))
    return Erratum(
        11,
        "eq. (12)",
        "one turn brings each joint into its range",
        "wrap, then check the range",
        f"theta_2 = 60 deg becomes -300 deg, still outside [{low:.0f}, {high:.0f}]",
    )


def _jacobian(motion: Motion) -> Erratum:
    """The gradient by autograd equals -2 J_e^T e, J_e the derivative of the twelve pose entries."""
    robot = load_robot("kr210")
    q = motion.q_start.clone().requires_grad_()
    pose = robot.chain.forward_kinematics(q[None]).get_matrix()[0]
    (gradient,) = torch.autograd.grad(entry_error(pose, motion.T_target), q)
    T, J = pose_and_jacobian(robot, q.detach())
    turned = torch.linalg.cross(J[3:, :, None], T[:3, None, :3], dim=0)  # (3, 6, 3): dR = w x R
    columns = torch.cat([turned, J[:3, :, None]], dim=-1)  # (3, 6, 4): d(pose entries)/dq_k
    e = (motion.T_target - T)[:3]
    difference = (gradient + 2 * torch.einsum("ikj,ij->k", columns, e)).abs().max()
    return Erratum(
        12,
        "text",
        "no Jacobian is used",
        "the gradient is -2 J^T e of the pose entries",
        f"autograd and J^T e differ by {difference:.0e} at the start of {motion.name}",
    )


def _fk(q: Tensor) -> Tensor:
    return forward_kinematics(load_robot("kr210"), q)


__all__ = ["Erratum", "errata", "printed_joints"]
