"""Is there a solution near a configuration? A check on jumps that owes nothing to the solver that is judged."""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.kinematics import pose_and_jacobian, pose_error
from ikgrad.robot import Robot

STARTS = 32
STEPS = 60


def solvable_nearby(
    robot: Robot, T: Tensor, q: Tensor, radius: float, *, tol_pos: float = 1e-6, tol_rot: float = 1e-6
) -> Tensor:
    """True where some configuration within ``radius`` of ``q`` in every joint, and inside the limits, has the pose.

    Damped least squares in plain torch with the joints held in the box, from ``q`` and from random configurations in
    the box. "No" is not proven, "yes" is.

    Args:
        robot: the robot, n joint variables.
        T: (B, 4, 4)
        q: (B, n)
        radius: half the side of the box [rad or m].
        tol_pos: [m]
        tol_rot: [rad]

    Returns:
        (B,) bool
    """
    low, high = torch.maximum(q - radius, robot.q_min), torch.minimum(q + radius, robot.q_max)
    low, high, target = (x.repeat_interleave(STARTS, dim=0) for x in (low, high, T))
    share = torch.rand(len(target), robot.dof, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    x = low + share * (high - low)
    x[::STARTS] = q.clamp(low[::STARTS], high[::STARTS])
    found = torch.zeros(len(target), dtype=torch.bool)
    for _ in range(STEPS):
        now, J = pose_and_jacobian(robot, x)
        error = pose_error(now, target)
        found |= (error[:, :3].norm(dim=-1) <= tol_pos) & (error[:, 3:].norm(dim=-1) <= tol_rot)
        slope = (J.mT @ error[..., None])[..., 0]
        held = ((x <= low) & (slope < 0)) | ((x >= high) & (slope > 0))
        J = torch.where(held[:, None, :], 0.0, J)
        damping = (1e-2 * error.square().sum(dim=-1) + 1e-12)[:, None, None] * torch.eye(6, dtype=torch.float64)
        step = J.mT @ torch.linalg.solve(J @ J.mT + damping, error[..., None])
        x = (x + step[..., 0].clamp(-radius / 2, radius / 2)).clamp(low, high)
    return found.view(-1, STARTS).any(dim=1)
