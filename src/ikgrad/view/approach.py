"""As near to a target as can be, where there is no solution."""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics, jacobian, pose_error
from ikgrad.robot import Robot
from ikgrad.solvers.damped import MAX_STEP, typical_length


def approach(robot: Robot, T_target: Tensor, q: Tensor, *, position_only: bool = False, steps: int = 60) -> Tensor:
    """(n,) as near to a target as steps downhill lead, inside the limits; never farther away than the start.

    Levenberg-Marquardt on |e|^2, e = [(p* - p) / L; log(R* R^T)], where a step that does not lower it is refused and
    damped more. (The steps of `solve_ik` may rise; an arm that is stretched out would tremble.)

    Args:
        robot: the robot, n joint variables.
        T_target: (4, 4) the target [m].
        q: (n,) where to start.
        position_only: do not turn the tool.
        steps: at most so many.
    """
    low, high, length = robot.q_min, robot.q_max, typical_length(robot)
    unit = torch.ones_like(q).masked_fill(~robot.revolute, length)
    weight = q.new_tensor([1 / length] * 3 + [0.0 if position_only else 1.0] * 3)
    q, damping = q.clamp(low, high), 1e-2
    e, J = _linearised(robot, T_target, q, weight)
    for _ in range(steps):
        slope = J.mT @ e
        free = J.masked_fill(((q >= high) & (slope > 0)) | ((q <= low) & (slope < 0)), 0.0) * unit
        A = free @ free.mT + damping * torch.eye(6).to(e)
        tried = (q + unit * (free.mT @ torch.linalg.solve(A, e)).clamp(-MAX_STEP, MAX_STEP)).clamp(low, high)
        e_tried, J_tried = _linearised(robot, T_target, tried, weight)
        gain = 1 - float(e_tried @ e_tried) / max(float(e @ e), 1e-30)
        if gain > 0:
            q, e, J, damping = tried, e_tried, J_tried, 0.2 * damping
        else:
            damping = 5 * damping
        if 0 < gain < 1e-7 or damping > 1e6:
            break
    return q


def _linearised(robot: Robot, T_target: Tensor, q: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    e = pose_error(forward_kinematics(robot, q), T_target)
    return e * weight, jacobian(robot, q) * weight[:, None]


__all__ = ["approach"]
