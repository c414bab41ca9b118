"""What an answer costs: the pose that is missing, by forward kinematics, with a gradient that needs no autograd.

For ``s = |e|^2`` with e the pose error of an answer q, ``ds/dq = -2 J^T e`` exactly, the rotation part too (the
derivative of the logarithm leaves its own vector alone). The compiled kernel gives J^T e in the pass that gives e, so
that a loss costs one forward kinematics, and the chain never enters the graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps


@dataclass(frozen=True)
class PoseLoss:
    r"""Mean over rows of ``pose rho(s)``, ``s = |position / length|^2 + |rotation|^2``, and what keeps answers inside.

    ==========  ======================  =============================================================
    shape       rho                     what it asks for
    ==========  ======================  =============================================================
    square      s                       the worst rows count most
    root        sqrt(s + delta^2)       every millimetre counts alike (pseudo-Huber)
    log         log(s + delta^2)        halving any error counts alike, down to delta
    ==========  ======================  =============================================================

    Joints beyond a limit are judged at the limit; a gradient that draws them farther out is dropped, and ``limits``
    draws them back.

    Attributes:
        shape: of rho.
        delta: error below which rho is flat [rad, or typical lengths of the arm].
        pose: weight of rho; 0 with ``joints=1``: plain regression of the labels.
        limits: weight of half the squared distance beyond the limits.
        joints: weight of the distance to the label, ``sqrt(|q - label|^2 + 1e-4)``; 0: labels are not looked at.

    Raises:
        ConfigError: a setting is out of range.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T, label, q = ik.data.TaskStream(robot, batch_size=9).batch(0)
        >>> loss = PoseLoss(shape="square")
        >>> float(loss(robot, label, T)) < 1e-12 < float(loss(robot, q, T))
        True
    """

    shape: Literal["square", "root", "log"] = "root"
    delta: float = 0.02
    pose: float = 1.0
    limits: float = 0.5
    joints: float = 0.0

    def __post_init__(self) -> None:
        if self.shape not in ("square", "root", "log"):
            raise ConfigError(f"shape must be square, root or log, got '{self.shape}'")
        if not self.delta > 0:
            raise ConfigError(f"delta must be positive, got {self.delta}")
        for name in ("pose", "limits", "joints"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ConfigError(f"{name} must be a finite weight, 0 or more, got {getattr(self, name)}")

    def __call__(self, robot: Robot, q: Tensor, T: Tensor, label: Tensor | None = None) -> Tensor:
        """The loss of answers.

        Args:
            robot: the robot, n joint variables.
            q: (B, n) answers; may lie beyond the limits.
            T: (B, 4, 4) wanted poses [m].
            label: (B, n) wanted joints, for the weight ``joints``.

        Returns:
            () differentiable with respect to ``q``, once.
        """
        loss = _Pose.apply(q, T, robot, self)
        if self.joints > 0 and label is not None:
            loss = loss + self.joints * ((q - label).square().sum(-1) + 1e-4).sqrt().mean()
        return loss

    def rho(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """(B,) rho and its derivative for squared errors."""
        if self.shape == "square":
            return s, torch.ones_like(s)
        soft = s + self.delta**2
        if self.shape == "log":
            return soft.log(), 1 / soft
        return soft.sqrt(), 0.5 / soft.sqrt()


class _Pose(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, q: Tensor, T: Tensor, robot: Robot, loss: PoseLoss) -> Tensor:
        at = damped_steps(robot, T, q)
        value, slope = loss.rho(at.error.square().sum(-1))
        grad = -2.0 * loss.pose * slope[:, None] * at.slope.sum(-2)
        low, high = robot.q_min.to(q), robot.q_max.to(q)
        outwards = ((q >= high) & (grad < 0)) | ((q <= low) & (grad > 0))
        beyond = q - at.q
        grad = torch.where(outwards, 0.0, grad) + loss.limits * beyond
        ctx.save_for_backward(grad / len(q))
        return loss.pose * value.mean() + 0.5 * loss.limits * beyond.square().sum(-1).mean()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None]:
        (grad,) = ctx.saved_tensors
        return grads[0] * grad, None, None, None


__all__ = ["PoseLoss"]
