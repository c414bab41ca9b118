"""Exact gradients through a solution, by the implicit function theorem, whatever found it.

At a solution the (masked) error e(q, T*, geometry) is zero, so a change of the target or of the robot's geometry moves
the joints by

    dq = J_f^+ de

with J_f the Jacobian without the joints that stand at a limit (they are held), and ^+ the Moore-Penrose inverse: the
smallest joint motion where the arm is redundant, the best approximation where it cannot follow. One solve of a 6x6
system per row in the backward pass; nothing of the iteration is stored.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ikgrad.kinematics import plain_forward_kinematics, pose_and_jacobian
from ikgrad.robot import Robot

_SMALL_PIVOT = 1e-5  # ratio of Cholesky pivots below which the 6x6 system is solved by eigenvectors instead


def attach_gradient(
    robot: Robot,
    q: Tensor,
    T_target: Tensor,
    *,
    success: Tensor,
    held: Tensor,
    mask: Tensor | None,
) -> Tensor:
    """The same joint values, differentiable with respect to ``T_target`` and the robot's geometry.

    Args:
        robot: the robot; gradients flow to geometry given by `Robot.with_geometry`.
        q: (B, n) solutions.
        T_target: (B, 4, 4) their targets.
        success: (B,) bool; other rows get zero gradient.
        held: (B, n) bool, joints that stand at a limit.
        mask: (6,) ones and zeros along the target's own axes, or None.

    Returns:
        (B, n) equal to ``q``.
    """
    q = q.detach()
    T = plain_forward_kinematics(robot, q)  # a constant of T_target, a function of the geometry
    R, R_target = T[:, :3, :3], T_target[:, :3, :3]
    E = R_target @ R.mT  # near the identity: log E is its skew part, to second order
    skew = torch.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], dim=-1)
    e = torch.cat([T_target[:, :3, 3] - T[:, :3, 3], skew / 2], dim=-1)  # (B, 6)
    with torch.no_grad():
        J = pose_and_jacobian(robot, q)[1].to(q)
        frame = torch.block_diag(torch.ones(3, 3), torch.ones(3, 3)).to(q) * R_target.mT.repeat(1, 2, 2)
        rows = torch.eye(6).to(q).expand_as(frame) if mask is None else frame * mask[:, None]
        J = torch.where(held[:, None, :] | ~success[:, None, None], 0.0, rows @ J)
    if mask is not None:
        e = (rows @ e[..., None])[..., 0]
    return q + _PullBack.apply(e, J)


class _PullBack(torch.autograd.Function):
    """Zero in value; grad_e = (J^+)^T grad_q in the backward pass."""

    @staticmethod
    def forward(ctx: Any, e: Tensor, J: Tensor) -> Tensor:
        ctx.save_for_backward(J)
        return e.new_zeros(J.shape[0], J.shape[2])

    @staticmethod
    @once_differentiable  # J is taken as it is; a second derivative would silently lack its change
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (J,), (grad_q,) = ctx.saved_tensors, grads
        return pseudo_inverse_transposed(J, grad_q), None


def pseudo_inverse_transposed(J: Tensor, g: Tensor) -> Tensor:
    """(J^+)^T g = (J J^T)^+ J g for (B, 6, n) and (B, n): by Cholesky, by eigenvectors where J has lost rank.

    Example:
        >>> import torch
        >>> J, g = torch.randn(3, 6, 7).double(), torch.randn(3, 7).double()
        >>> direct = (torch.linalg.pinv(J).mT @ g[..., None])[..., 0]
        >>> torch.allclose(pseudo_inverse_transposed(J, g), direct)
        True
    """
    A, b = J @ J.mT, J @ g[..., None]
    factor, info = torch.linalg.cholesky_ex(A)
    pivots = factor.diagonal(dim1=-2, dim2=-1)
    bad = (info != 0) | ~(pivots.amin(dim=-1) > _SMALL_PIVOT * pivots.amax(dim=-1))
    factor = torch.where(bad[:, None, None], torch.eye(6).to(J), factor)
    x = torch.cholesky_solve(b, factor)
    index = torch.nonzero(bad).flatten()
    if len(index):
        x = x.index_copy(0, index, torch.linalg.pinv(J[index]).mT @ g[index][..., None])
    return x[..., 0]
