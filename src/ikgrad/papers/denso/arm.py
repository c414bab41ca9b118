"""The arm of the paper: home, the printed matrices against ours, and the closed form for the gripper straight down."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.errors import ShapeError
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.printed import numbers, read_table
from ikgrad.robot import Robot, load_robot
from ikgrad.solvers.solve import solve_ik

HOME_DEG = (0.0, 90.0, 180.0, 0.0, -90.0, 0.0)
HOME = tuple(math.radians(angle) for angle in HOME_DEG)
D1, A2, A3, D4, TOOL = 0.125, 0.21, -0.075, 0.21, 0.17  # [m]; the tool is flange 0.07 and gripper 0.10


@dataclass(frozen=True)
class MatrixRow:
    """One printed matrix against ours.

    Attributes:
        name: as in the paper.
        at: where ours is taken.
        difference: largest absolute difference of an entry [m and 1].
        note: what there is to say.
    """

    name: str
    at: str
    difference: float
    note: str


@functools.cache
def denso() -> Robot:
    """The arm with its gripper, read once."""
    return load_robot("denso_vp6242")


def printed_matrix(name: str) -> Tensor:
    """(4, 4) a printed matrix, ``"A_1"`` to ``"A_6"`` or ``"T_Home"``."""
    rows = [row for row in read_table("denso_matrices") if row["matrix"] == name]
    return torch.tensor([numbers(row, "col1", "col2", "col3", "col4_m") for row in rows], dtype=torch.float64)


def dh_matrices(*, d6: float) -> Tensor:
    """(6, 4, 4) the A_i of Table 1 at q = 0, with a last offset of choice.

    Example:
        >>> T = torch.linalg.multi_dot(list(dh_matrices(d6=0.17)))
        >>> [round(x, 3) for x in T[:3, 3].tolist()]
        [0.135, 0.0, 0.505]
    """
    matrices = []
    for row in read_table("denso_dh"):
        d, a, alpha = numbers(row, "d_printed_m", "a_m", "alpha_rad")
        d = d6 if row["link"] == "6" else d
        ca, sa = round(math.cos(alpha), 15), round(math.sin(alpha), 15)
        matrices.append([[1.0, 0.0, 0.0, a], [0.0, ca, -sa, 0.0], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]])
    return torch.tensor(matrices, dtype=torch.float64)


def check_matrices() -> tuple[MatrixRow, ...]:
    """A_1 to A_6 and T_home, printed against ours; what they say about d_6 and the gripper."""
    ours, short = dh_matrices(d6=TOOL), dh_matrices(d6=0.07)
    rows = []
    for k in range(6):
        difference = (printed_matrix(f"A_{k + 1}") - ours[k]).abs().max().item()
        note = "with d_6 = 0.17 = flange 0.07 + gripper 0.10" if k == 5 else ""
        rows.append(MatrixRow(f"A_{k + 1}", "q = 0", difference, note))
    off = (printed_matrix("A_6") - short[5]).abs().max().item()
    rows.append(MatrixRow("A_6", "q = 0", off, "with Table 1's d_6 = 0.07"))
    home = forward_kinematics(denso(), torch.tensor(HOME, dtype=torch.float64))
    rows.append(MatrixRow("T_Home", "q_home", _off(home), "q_home = (0, 90, 180, 0, -90, 0) deg"))
    product = torch.linalg.multi_dot(list(ours))
    rows.append(MatrixRow("T_Home", "q = 0", _off(product), "the product of the printed matrices is not T_home"))
    return tuple(rows)


def home_companions() -> Tensor:
    """(k, 6) different joint values that give the pose of home, joint limits aside, home first [deg].

    Example:
        >>> home_companions()[0].round(decimals=6).tolist()
        [0.0, 90.0, 180.0, 0.0, -90.0, 0.0]
    """
    robot = denso()
    home = torch.tensor(HOME, dtype=torch.float64)
    T = forward_kinematics(robot, home)
    found = solve_ik(robot, T, q0=home, solutions=9, tol_pos=1e-12, tol_rot=1e-12, limits=False)
    return found.q[found.success].rad2deg() + 0.0


def tool_down_ik(p: Tensor) -> Tensor:
    r"""Joints that put the gripper at positions, straight down as at home (rotation diag(-1, 1, -1)), in closed form.

    With ``r = hypot(x, y)`` and ``w = z + 0.17 - 0.125`` the wrist centre in the plane of the arm, the elbow from the
    law of cosines, ``K = (r^2 + w^2 - a_2^2 - a_3^2 - d_4^2) / (2 a_2) = a_3 cos q3 - d_4 sin q3``, of whose two roots
    the one near pi is taken (the branch of home); then q2 from two directions in the plane, q4 = 0, q6 = q1, and
    q5 = pi - q2 - q3 (mod 2 pi).

    Args:
        p: (..., 3) positions of the gripper [m].

    Returns:
        (..., 6) joints [rad]; NaN where the arm does not reach.

    Raises:
        ShapeError: the last dimension is not 3.

    Example:
        >>> tool_down_ik(torch.tensor([0.21, 0.0, 0.24], dtype=torch.float64)).rad2deg().round().tolist()
        [0.0, 90.0, 180.0, 0.0, -90.0, 0.0]
    """
    if p.shape[-1:] != (3,):
        raise ShapeError(f"p must have shape (..., 3), got {tuple(p.shape)}")
    x, y, z = p.unbind(-1)
    q1 = torch.atan2(y, x)
    r, w = torch.hypot(x, y), z + TOOL - D1
    K = (r.square() + w.square() - A2**2 - A3**2 - D4**2) / (2 * A2)
    # a_3 cos q3 - d_4 sin q3 = rho cos(q3 - phi)
    phi, rho = math.atan2(-D4, A3), math.hypot(D4, A3)
    half = torch.acos(K / rho)
    q3 = phi + torch.stack([half, -half], dim=-1)
    q3 = torch.remainder(q3, 2 * math.pi)  # both in [0, 2 pi), so that the one near pi can be told
    q3 = q3.take_along_dim((q3 - math.pi).abs().argmin(-1, keepdim=True), -1).squeeze(-1)
    f1, f2 = A3 * q3.cos() - D4 * q3.sin(), A3 * q3.sin() + D4 * q3.cos()
    q2 = torch.atan2(w, r) - torch.atan2(f2, A2 + f1)
    q5 = math.pi - q2 - q3
    q5 = torch.atan2(q5.sin(), q5.cos())
    return torch.stack([q1, q2, q3, torch.zeros_like(q1), q5, q1], dim=-1)


def _off(T: Tensor) -> float:
    return (printed_matrix("T_Home") - T).abs().max().item()


__all__ = [
    "HOME",
    "HOME_DEG",
    "MatrixRow",
    "check_matrices",
    "denso",
    "dh_matrices",
    "home_companions",
    "printed_matrix",
    "tool_down_ik",
]
