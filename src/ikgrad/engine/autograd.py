"""The kernels as torch functions: tensors in, tensors out, without copies, differentiable."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ikgrad import engine
from ikgrad.robot import Robot


def forward_kinematics(robot: Robot, q: Tensor) -> Tensor:
    """(..., n) -> (..., 4, 4) for float64 tensors on the CPU."""
    if q.requires_grad and torch.is_grad_enabled():
        return _ForwardKinematics.apply(q, robot)
    return _poses(robot, q)


def jacobian(robot: Robot, q: Tensor) -> Tensor:
    """(..., n) -> (..., 6, n) for float64 tensors on the CPU; not differentiable."""
    rows = q.detach().reshape(-1, robot.dof).numpy()
    J = engine.jacobian(engine.pack(robot), rows, threads=torch.get_num_threads())
    return torch.from_numpy(J).view(*q.shape[:-1], 6, robot.dof)


def _poses(robot: Robot, q: Tensor) -> Tensor:
    rows = q.detach().reshape(-1, robot.dof).numpy()
    T = engine.fk(engine.pack(robot), rows, threads=torch.get_num_threads())
    return torch.from_numpy(T).view(*q.shape[:-1], 4, 4)


class _ForwardKinematics(torch.autograd.Function):
    """FK with the one-pass vector-Jacobian product of `engine.fk_vjp` as its backward."""

    @staticmethod
    def forward(ctx: Any, q: Tensor, robot: Robot) -> Tensor:
        ctx.save_for_backward(q)
        ctx.robot = robot
        return _poses(robot, q)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (q,), (grad_T,) = ctx.saved_tensors, grads
        if torch.is_grad_enabled():  # somebody differentiates twice: torch operations all the way
            from ikgrad.kinematics import plain_forward_kinematics

            T = plain_forward_kinematics(ctx.robot, q)
            return torch.autograd.grad(T, q, grad_T, create_graph=True)[0], None
        rows, grad_rows = q.reshape(-1, ctx.robot.dof).numpy(), grad_T.reshape(-1, 4, 4).numpy()
        grad = engine.fk_vjp(engine.pack(ctx.robot), rows, grad_rows, threads=torch.get_num_threads())
        return torch.from_numpy(grad).view(q.shape), None
