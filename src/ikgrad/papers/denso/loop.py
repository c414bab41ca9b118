"""The closed loop: many inverters on many paths at once, each fed with its own answers, errors by Table 1's matrices.

`Inverter.rollout` follows one path with one inverter. Here S inverters follow P paths each, in two small matrix
products a tick, and a damped step through FK may correct every answer before it becomes the present joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ikgrad.networks import Inverter, encode_pose
from ikgrad.papers.denso.arm import TOOL, denso, dh_matrices
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps

Array = NDArray[np.float64]
DAMPING = 1e-3  # of the correction; it starts near the answer, where plain Newton steps are the best


@dataclass(frozen=True)
class Folded:
    """S networks with one hidden layer of tanh, their scaling folded into the weights: ``q' = tanh(z + q C) W + b``.

    Attributes:
        current: (S, n, h) the C.
        out: (S, h, n) the W.
        bias: (S, 1, n) the b.
        skip: 1: the network says what to add to q; 0: it says q'.
    """

    current: Array
    out: Array
    bias: Array
    skip: float

    def answer(self, z: Array, q: Array) -> Array:
        """(S, P, n) the next joints, for what the poses contribute, (S, P, h), and the present joints (S, P, n)."""
        answer = np.tanh(z + q @ self.current) @ self.out + self.bias
        return q + answer if self.skip else answer

    def derivative(self, z: Array, q: Array) -> Array:
        """(S, ..., n, n) of the next joints by the present ones, indices [next, present]; z (S, ..., h)."""
        lead = (slice(None), *[None] * (z.ndim - 2))
        slope = 1 - np.tanh(z + (q[..., None, :] @ self.current[lead])[..., 0, :]) ** 2
        J = (self.current[lead] * slope[..., None, :]) @ self.out[lead]
        return np.swapaxes(J, -1, -2) + self.skip * np.eye(J.shape[-1])


@torch.no_grad()
def fold(inverters: Sequence[Inverter], T: Tensor) -> tuple[Folded, Array]:
    """Inverters of one hidden layer as `Folded`, and what each pose contributes to the hidden units.

    Args:
        inverters: S of one make; traditional ones have zeros for C.
        T: (S, ..., 4, 4) poses.

    Returns:
        The networks and z (S, ..., h).
    """
    parts = [_fold_one(inverter, poses) for inverter, poses in zip(inverters, T, strict=True)]
    z, current, out, bias = (torch.stack(part).numpy() for part in zip(*parts, strict=True))
    return Folded(current, out, bias, float(getattr(inverters[0], "increment", False))), z


def _fold_one(inverter: Inverter, T: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    net, scale, half = inverter.network, inverter.input_scale, inverter.output_scale.span / 2
    assert (len(net.weights), net.hidden, net.output) == (2, "tanh", "linear")
    slope = torch.where(scale.span > 0, 2 / scale.span, 0.0)  # columns without a span are not looked at
    offset = -1.0 - slope * scale.minimum
    weight = slope[:, None] * net.weights[0]
    pose = encode_pose(T, inverter.reference, encoding=inverter.encoding)
    k, n = pose.shape[-1], len(half)
    z = pose @ weight[:k] + offset @ net.weights[0] + net.biases[0].squeeze(0)
    current = weight[k:] if inverter.feedback else weight.new_zeros(n, weight.shape[1])
    bias = half * net.biases[1]
    if not getattr(inverter, "increment", False):
        bias = bias + inverter.output_scale.minimum + half
    return z, current, half * net.weights[1], bias


def closed_loop(
    inverters: Sequence[Inverter], T: Tensor, q_start: Tensor, *, ticks: int, corrections: int = 0
) -> Tensor:
    """Follow closed paths, every answer being the present joints of the next tick.

    Args:
        inverters: S of one make; none: the present joints are the answer, so that the corrections do all the work.
        T: (S, P, L, 4, 4) one lap of P paths for each.
        q_start: (S, P, n) present joints before the first tick.
        ticks: how long; after L ticks a new lap begins.
        corrections: damped steps through FK after every answer, before it is used.

    Returns:
        (ticks, S, P, n) joints.
    """
    laps = T.shape[2]
    q, answers = q_start.numpy(), np.empty((ticks, *q_start.shape))
    if inverters:
        folded, z = fold(inverters, T)
        z = np.ascontiguousarray(np.moveaxis(z, 2, 0))  # (L, S, P, h)
    robot, targets = denso(), T.movedim(2, 0).contiguous()
    for tick in range(ticks):
        if inverters:
            q = folded.answer(z[tick % laps], q)
        if corrections:
            q = _corrected(robot, targets[tick % laps], q, corrections)
        answers[tick] = q
    return torch.from_numpy(answers)


def gains(inverters: Sequence[Inverter], T: Tensor, q_current: Tensor) -> Tensor:
    """Spectral radius of dq_out/dq_current: what becomes of an error of the present joints in the long run.

    Joints that are constant in the data are left out: an inverter gives them back as they were.

    Args:
        inverters: S of one make.
        T: (S, ..., 4, 4) poses.
        q_current: (S, ..., n) present joints.

    Returns:
        (S, ...)
    """
    folded, z = fold(inverters, T)
    moving = np.flatnonzero(np.abs(folded.out).max((0, 1)) > 0)
    J = folded.derivative(z, q_current.numpy())[..., moving[:, None], moving]
    return torch.from_numpy(np.abs(np.linalg.eigvals(J)).max(-1))


def _corrected(robot: Robot, T: Tensor, q: Array, steps: int) -> Array:
    return damped_steps(robot, T, torch.from_numpy(q), steps=steps, damping=DAMPING).q.numpy()


def position(q: Tensor) -> Tensor:
    """(..., 3) gripper [m] for joints (..., 6), by the matrices of Table 1 and not by the robot's own chain.

    Example:
        >>> position(torch.tensor([0.0, 90.0, 180.0, 0.0, -90.0, 0.0], dtype=torch.float64).deg2rad()).round(decimals=6)
        tensor([0.2100, 0.0000, 0.2400], dtype=torch.float64)
    """
    p = q.new_zeros(*q.shape[:-1], 3)
    for k, A in reversed(list(enumerate(dh_matrices(d6=TOOL)))):
        p = p @ A[:3, :3].T + A[:3, 3]  # A_k at q = 0, then the turn about z
        c, s = q[..., k].cos(), q[..., k].sin()
        x, y, z = p.unbind(-1)
        p = torch.stack([c * x - s * y, s * x + c * y, z], dim=-1)
    return p + 0.0


__all__ = ["Folded", "closed_loop", "fold", "gains", "position"]
