"""Damped steps for all rows in lock step: what a network holds of the chain, and the baseline that it must beat.

No restarts, no rows that leave, no gradient: a fixed number of Levenberg-Marquardt steps, and a look at the next one.
On the CPU compiled (`ikgrad.engine.damped`), elsewhere in torch operations; so also when a graph is drawn
(`torch.export`, ONNX), for which these are operations that exchange formats have in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.kinematics import check_poses, check_q, no_transform, pose_and_jacobian
from ikgrad.robot import Robot
from ikgrad.rotations import drawn_log_rotation

DAMPING = 0.1  # best for local tasks of all built-in arms: larger is slower, smaller leaves more rows behind
MAX_STEP = 0.8  # rad, or typical lengths


class Damped(NamedTuple):
    """Where the rows stand after the steps, and what lies ahead.

    Attributes:
        q: (..., n) joints, inside the limits [rad or m].
        error: (..., 6) ``[R^T (p* - p) / length; R^T log(R* R^T)]``: the pose that is missing, as the tip sees it.
        step: (..., n) the next damped step, cut at the limits [rad or m].
        slope: (..., 2, n) ``J^T e`` of the position and of the rotation: minus half the gradient of ``|e|^2``.
    """

    q: Tensor
    error: Tensor
    step: Tensor
    slope: Tensor


def typical_length(robot: Robot) -> float:
    """A quarter of the summed link lengths [m], 1 m if there are none: position errors count divided by it."""
    return robot.detach().typical_length


def damped_steps(
    robot: Robot, T_target: Tensor, q: Tensor, *, steps: int = 0, damping: float = DAMPING, max_step: float = MAX_STEP
) -> Damped:
    """Take some damped steps towards targets, and look at the next one. Nothing is differentiable here.

    With lengths divided by `typical_length`, and J_f the Jacobian without the joints that stand at a limit and are
    drawn outwards,

        dq = J_f^T (J_f J_f^T + mu I)^-1 e,     mu = damping |e|^2 + 1e-12
        q <- clamp(q + clip(dq, -max_step, +max_step), q_min, q_max)

    Args:
        robot: the robot, n joint variables.
        T_target: (..., 4, 4) wanted poses [m].
        q: (..., n) where to start; clamped to the limits first.
        steps: how many to take before looking.
        damping: factor of |e|^2 in mu.
        max_step: largest change of a joint in a step [rad, or typical lengths for slides].

    Returns:
        Rows of the dtype and device of ``q``.

    Raises:
        ShapeError: shapes or dtypes do not fit.
        ConfigError: ``steps`` is negative, or a setting is not positive.

    Source:
        Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method (2011), eq. (17).

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> q = ik.sample_configurations(robot, 5, seed=0)
        >>> T = ik.forward_kinematics(robot, 0.9 * q)
        >>> before, after = (damped_steps(robot, T, q, steps=k).error.norm(dim=-1) for k in (0, 5))
        >>> bool((after < 0.1 * before).all())
        True
    """
    check_poses("T_target", T_target)
    check_q(robot, q)
    if steps < 0:
        raise ConfigError(f"steps must not be negative, got {steps}")
    for name, value in (("damping", damping), ("max_step", max_step)):
        if not value > 0:
            raise ConfigError(f"{name} must be positive, got {value}")
    lead = torch.broadcast_shapes(T_target.shape[:-2], q.shape[:-1])
    T = T_target.detach().expand(*lead, 4, 4).reshape(-1, 4, 4).to(q.device)
    rows = q.detach().expand(*lead, -1).reshape(-1, robot.dof)
    run = _compiled if q.device.type == "cpu" and robot.geometry is None and no_transform() else _plain
    found = run(robot.detach(), T, rows, steps, damping, max_step)
    return Damped(*(part.to(q.dtype).reshape(*lead, *part.shape[1:]) for part in found))


def _compiled(robot: Robot, T: Tensor, q: Tensor, steps: int, damping: float, max_step: float) -> Damped:
    from ikgrad import engine
    from ikgrad.engine.damped import damped

    found = damped(
        engine.pack(robot), T.double().numpy(), q.double().numpy(), steps=steps, damping=damping, max_step=max_step,
        threads=torch.get_num_threads(),
    )  # fmt: skip
    return Damped(*(torch.from_numpy(part) for part in found))


def _plain(robot: Robot, T: Tensor, q: Tensor, steps: int, damping: float, max_step: float) -> Damped:
    """The same in torch operations alone; also what the kernel is tested against."""
    length, T = typical_length(robot), T.to(q)
    low, high = robot.q_min.to(q), robot.q_max.to(q)
    unit = torch.ones_like(low).masked_fill(~robot.revolute.to(q.device), length)  # of a variable, in rad or m
    shrink = q.new_tensor([1 / length] * 3 + [1.0] * 3)
    q = q.clamp(low, high)
    for turn in range(steps + 1):
        pose, J = pose_and_jacobian(robot, q)
        e = _missing(pose, T) * shrink
        J = J * shrink[:, None] * unit
        step = _step(J, e, q, low, high, damping, max_step) * unit
        step = (q + step).clamp(low, high) - q
        if turn < steps:
            q = (q + step).clamp(low, high)
    R, halves = pose[:, :3, :3], e.unflatten(-1, (2, 3))
    error = (R.mT[:, None] @ halves[..., None])[..., 0].flatten(1)
    slope = torch.stack([(J[:, 3 * i : 3 * i + 3].mT @ halves[:, i, :, None])[..., 0] for i in (0, 1)], dim=1)
    return Damped(q, error, step, slope / unit)


def _missing(T: Tensor, goal: Tensor) -> Tensor:
    """`ikgrad.kinematics.pose_error`, in operations that exchange formats have."""
    rotation = drawn_log_rotation(goal[:, :3, :3] @ T[:, :3, :3].mT)
    return torch.cat([goal[:, :3, 3] - T[:, :3, 3], rotation], dim=-1)


def _step(J: Tensor, e: Tensor, q: Tensor, low: Tensor, high: Tensor, damping: float, max_step: float) -> Tensor:
    slope = (J.mT @ e[..., None])[..., 0]
    held = ((q >= high) & (slope > 0)) | ((q <= low) & (slope < 0))
    J = torch.where(held[:, None, :], 0.0, J)
    factor, least, limit = e.new_tensor([damping, 1e-12, max_step])  # as numbers, an ONNX file has them in float32
    mu = factor * e.square().sum(-1) + least
    A = J @ J.mT + mu[:, None, None] * torch.eye(6).to(e)
    return (J.mT @ solve_spd(A, e)[..., None])[..., 0].clamp(-limit, limit)


def solve_spd(A: Tensor, b: Tensor) -> Tensor:
    """Solution of ``A x = b`` for a symmetric positive definite A, by Gauss-Jordan elimination without pivots.

    Exchange formats have no Cholesky factor; products and quotients they all have. Pivots of such a matrix are never
    zero, and none is exchanged, so the graph is a straight line.

    Args:
        A: (..., k, k)
        b: (..., k)

    Returns:
        (..., k)

    Example:
        >>> import torch
        >>> solve_spd(torch.tensor([[4.0, 2.0], [2.0, 3.0]]), torch.tensor([8.0, 8.0]))
        tensor([1., 2.])
    """
    k = A.shape[-1]
    M = torch.cat([A, b[..., None]], dim=-1)
    unit = torch.eye(k, dtype=A.dtype, device=A.device)
    for j in range(k):
        row = M[..., j : j + 1, :] / M[..., j : j + 1, j : j + 1]
        M = M - (M[..., :, j : j + 1] - unit[:, j : j + 1]) * row
    return M[..., k]


__all__ = ["DAMPING", "Damped", "MAX_STEP", "damped_steps", "solve_spd", "typical_length"]
