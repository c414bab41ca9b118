"""A batch of IK goals as the methods see it: rows of targets, and one definition of the error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics, pose_and_jacobian, pose_error
from ikgrad.robot import Robot
from ikgrad.rotations import log_rotation, rotation_angle


@dataclass(frozen=True, eq=False)
class Problem:
    """B goals for one robot, float64.

    Attributes:
        robot: the robot.
        T_target: (B, 4, 4) rigid transforms.
        key: (B,) int64 that the torch methods draw starts from: ``seed`` and the content of the row, see `starts`.
        q_min: (n,) limits to stay in, infinite if limits are off.
        q_max: (n,) likewise.
        mask: (6,) ones and zeros: which errors count, [x, y, z, rx, ry, rz] along the *target's own* axes; None for
            all of them (then in the base frame, which changes no norm).
        tol_pos: [m]
        tol_rot: [rad]
        seed: of random starts.
    """

    robot: Robot
    T_target: Tensor
    key: Tensor
    q_min: Tensor
    q_max: Tensor
    mask: Tensor | None
    tol_pos: float
    tol_rot: float
    seed: int = 0

    def rows(self, index: Tensor) -> Problem:
        """The problem of some of the rows."""
        return replace(self, T_target=self.T_target[index], key=self.key[index])

    def error(self, T: Tensor) -> Tensor:
        """(B, 6) what is missing to the target, masked."""
        e = pose_error(T, self.T_target)
        return e if self.mask is None else self._in_target_frame(e[..., None])[..., 0] * self.mask

    def linearise(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 6) error and (B, 6, n) the Jacobian of the motion that reduces it, both masked."""
        T, J = pose_and_jacobian(self.robot, q)
        e = self.error(T)
        return (e, J) if self.mask is None else (e, self._in_target_frame(J) * self.mask[:, None])

    def measure(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """(B,) distance [m] and angle [rad] to the target, from forward kinematics; masked parts do not count."""
        T = forward_kinematics(self.robot, q)
        if self.mask is not None:
            e = self.error(T)
            return e[..., :3].norm(dim=-1), e[..., 3:].norm(dim=-1)
        position = (self.T_target[..., :3, 3] - T[..., :3, 3]).norm(dim=-1)
        return position, rotation_angle(self.T_target[..., :3, :3] @ T[..., :3, :3].mT)

    def met(self, position_error: Tensor, rotation_error: Tensor) -> Tensor:
        """True where both errors are within tolerance."""
        return (position_error <= self.tol_pos) & (rotation_error <= self.tol_rot)

    def inside(self, q: Tensor) -> Tensor:
        """(B,) True where all joints are inside the limits."""
        return ((q >= self.q_min) & (q <= self.q_max)).all(dim=-1)

    def certainly_unreachable(self) -> Tensor:
        """(B,) True where the target is farther from the first joint than the arm is long.

        With the full pose given, the place of the last joint is known too, and the bound up to there is tighter.
        A masked position bounds nothing.
        """
        tables = self.robot.tables(dtype=self.T_target.dtype, device=self.T_target.device)
        if self.mask is not None and not bool(self.mask[:3].all()):
            return torch.zeros_like(self.key, dtype=torch.bool)
        shoulder, slack = tables.origins[0, :3, 3], 1 + 1e-9
        distance = (self.T_target[..., :3, 3] - shoulder).norm(dim=-1)
        far = distance > self.robot.reach_bound * slack + self.tol_pos
        if self.mask is None:
            wrist = (self.T_target @ torch.linalg.inv(tables.tool))[..., :3, 3]
            room = self.tol_pos + self.tol_rot * float(tables.tool[:3, 3].norm())
            far |= (wrist - shoulder).norm(dim=-1) > self.robot.wrist_bound * slack + room
        return far

    def _in_target_frame(self, columns: Tensor) -> Tensor:
        """Rotate both halves of (B, 6, k) columns from the base into the target's frame."""
        Rt = self.T_target[..., :3, :3].mT
        return torch.cat([Rt @ columns[..., :3, :], Rt @ columns[..., 3:, :]], dim=-2)


def tool_frame_rotation_error(T: Tensor, T_target: Tensor) -> Tensor:
    """(..., 3) rotation error log(R^T R*) in the frame of the tool (for the inconsistent Newton-Raphson variant)."""
    return log_rotation(T[..., :3, :3].mT @ T_target[..., :3, :3])
