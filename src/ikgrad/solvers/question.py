"""From the caller's tensors to a `Problem`: everything about a question is refused or repaired here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.kinematics import check_poses, check_q
from ikgrad.robot import Robot
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.starts import row_keys

ROTATION_TOLERANCE = 1e-4  # of |R^T R - I|: far beyond float32 rounding, far below any visible skew


class Question(NamedTuple):
    """A flat batch of goals."""

    problem: Problem  # B rows; the identity stands in for invalid targets
    q0: Tensor | None  # (B, n) float64
    valid: Tensor  # (B,) bool


def ask(
    robot: Robot,
    T_target: Tensor,
    *,
    q0: Tensor | None,
    tol_pos: float,
    tol_rot: float,
    limits: bool,
    mask: Tensor | Sequence[float] | None,
    seed: int,
) -> Question:
    """Flatten the batch, go to float64 and set invalid rows aside; the arguments have passed `check`."""
    shape, count = T_target.shape[:-2], T_target.shape[:-2].numel()
    T = T_target.detach().reshape(count, 4, 4).to(torch.float64)
    start = None if q0 is None else q0.detach().to(T).expand(*shape, robot.dof).reshape(count, robot.dof)
    valid = is_rigid(T)
    T = torch.where(valid[:, None, None], orthonormal(T), torch.eye(4).to(T))
    if start is not None:
        valid = valid & start.isfinite().all(dim=-1)
        start = torch.where(valid[:, None], start, torch.zeros_like(start))
    problem = Problem(
        robot=robot.detach().to(T.device, torch.float64),
        T_target=T,
        seed=seed,
        key=row_keys(T, start, seed),
        q_min=_limit(robot.q_min, limits, T, -math.inf),
        q_max=_limit(robot.q_max, limits, T, math.inf),
        mask=check_mask(mask, T),
        tol_pos=tol_pos,
        tol_rot=tol_rot,
    )
    return Question(problem, start, valid)


def check(robot: Robot, T: Tensor, q0: Tensor | None, tol_pos: float, tol_rot: float) -> None:
    """Refuse arguments that do not fit together."""
    check_poses("T_target", T)
    if q0 is not None:
        check_q(robot, q0, "q0")
        try:
            q0.expand(*T.shape[:-2], robot.dof)
        except RuntimeError as error:
            raise ShapeError(f"q0 of shape {tuple(q0.shape)} does not fit poses of shape {tuple(T.shape)}") from error
    for name, value in (("tol_pos", tol_pos), ("tol_rot", tol_rot)):
        if not value > 0:
            raise ConfigError(f"{name} must be positive, got {value}")


def check_mask(mask: Tensor | Sequence[float] | None, like: Tensor) -> Tensor | None:
    """(6,) of ones and zeros, or None if every error counts."""
    if mask is None:
        return None
    given = torch.as_tensor(mask).to(like)
    if given.shape != (6,):
        raise ShapeError(f"mask must have shape (6,), got {tuple(given.shape)}")
    if not bool(((given == 0) | (given == 1)).all()) or not bool(given.any()):
        raise ConfigError(f"mask must be six zeros or ones, not all zero, got {given.tolist()}")
    return None if bool(given.all()) else given


def _limit(limit: Tensor, on: bool, like: Tensor, none: float) -> Tensor:
    return limit.to(like) if on else torch.full_like(limit, none).to(like)


def is_rigid(T: Tensor) -> Tensor:
    """(...) True where (..., 4, 4) is a finite rigid transform: |R^T R - I| small, det R > 0, last row 0 0 0 1."""
    R = torch.where(T.isfinite().all(dim=-1).all(dim=-1)[..., None, None], T, torch.zeros_like(T))[..., :3, :3]
    skew = (R.mT @ R - torch.eye(3).to(T)).abs().amax(dim=(-2, -1))
    bottom = (T[..., 3, :] - torch.tensor([0.0, 0.0, 0.0, 1.0]).to(T)).abs().amax(dim=-1)
    return (skew <= ROTATION_TOLERANCE) & (bottom <= ROTATION_TOLERANCE) & (torch.linalg.det(R) > 0)


def orthonormal(T: Tensor) -> Tensor:
    """Remove the rounding of a target's rotation: two steps R <- R (3 I - R^T R) / 2, each squaring the error."""
    T, R = T.clone(), T[..., :3, :3]
    for _ in range(2):
        R = R @ (1.5 * torch.eye(3).to(R) - 0.5 * R.mT @ R)
    T[..., :3, :3] = R
    T[..., 3, :] = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(T)
    return T
