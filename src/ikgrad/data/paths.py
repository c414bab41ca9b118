"""Paths for an arm to follow: smooth ones in joint space, and straight lines that it can follow.

Each set is a pure function of the robot, the numbers of paths and points, and a seed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.data.configurations import sample_configurations
from ikgrad.errors import RobotError
from ikgrad.kinematics import forward_kinematics, pose_and_jacobian
from ikgrad.robot import Robot
from ikgrad.rotations import log_rotation, matrix_from_quat_wxyz
from ikgrad.solvers.damped import damped_steps, typical_length

_SPAN = 0.8  # rad: how far the joints of a line's end are from those of its start, before the line is straightened
_SMOOTH = 0.1  # rad from point to point: a line that asks for more passes a singularity or a limit
_CANDIDATES = 8  # lines that are tried for each one wanted
_STEPS, _SOLVED = 12, 1e-9  # of the search for the next point, from the last one; rad or typical lengths


def clear_paths(robot: Robot, paths: int, points: int, seed: int) -> Tensor:
    """(paths, points, n) smooth closed joint-space paths that keep clear of limits and singular configurations.

    One to three sine waves of 0.5 rad (or 0.1 arm lengths) a joint about a random configuration; kept if they stay
    0.05 inside the limits and the smallest singular value of the Jacobian, lengths in units of the arm's, stays above
    0.03 all along. What is left is a path that an arm can really follow.

    Raises:
        RobotError: hardly any path of this robot keeps clear.
    """
    low, high = robot.sampling_range
    wide = torch.where(robot.revolute, 0.5, 0.1 * robot.length)
    generator = torch.Generator().manual_seed(seed)
    middle = sample_configurations(robot, 400 * paths, seed=seed)
    time = 2 * math.pi * torch.linspace(0, 1, points, dtype=torch.float64)[:, None]
    found: list[Tensor] = []
    for q in middle:
        waves = torch.randint(1, 4, (robot.dof,), generator=generator)
        phase = 2 * math.pi * torch.rand(robot.dof, dtype=torch.float64, generator=generator)
        path = q + wide * torch.sin(waves * time + phase)
        if bool(((path > low + 0.05) & (path < high - 0.05)).all()) and _stays_regular(robot, path):
            found.append(path)
            if len(found) == paths:
                return torch.stack(found)
    raise RobotError(
        f"robot '{robot.name}': only {len(found)} of {len(middle)} random paths keep clear, {paths} wanted"
    )


def _stays_regular(robot: Robot, path: Tensor, least: float = 0.03) -> bool:
    J = pose_and_jacobian(robot, path)[1]
    unit = torch.tensor([1 / robot.length] * 3 + [1.0] * 3, dtype=J.dtype)
    return bool((torch.linalg.svdvals(J * unit[:, None])[:, min(6, robot.dof) - 1] > least).all())


def smooth_paths(robot: Robot, paths: int, points: int, seed: int) -> Tensor:
    """(paths, points, n) joint-space paths: three slow sine waves a joint, at most 0.9 of the range from its middle."""
    generator = torch.Generator().manual_seed(seed)
    shape = (paths, 1, robot.dof, 3)
    share = torch.rand(shape, dtype=torch.float64, generator=generator)
    share = share / share.sum(dim=-1, keepdim=True)
    waves = 0.2 + 1.3 * torch.rand(shape, dtype=torch.float64, generator=generator)
    phase = 2 * math.pi * torch.rand(shape, dtype=torch.float64, generator=generator)
    time = torch.linspace(0, 1, points, dtype=torch.float64)[:, None, None]
    low, high = robot.sampling_range
    swing = (share * torch.sin(2 * math.pi * waves * time + phase)).sum(dim=-1)
    return (low + high) / 2 + 0.45 * (high - low) * swing


class Lines(NamedTuple):
    """Straight lines, and one way to follow them.

    Attributes:
        q: (paths, points, n) joints that follow them without a jump [rad or m].
        T: (paths, points, 4, 4) poses [m].
    """

    q: Tensor
    T: Tensor


def straight_lines(robot: Robot, paths: int, points: int, seed: int) -> Lines:
    """Straight lines in task space that the arm can follow: the position moves evenly, the rotation about a fixed axis.

        p(s) = p_0 + s (p_1 - p_0),     R(s) = R_0 exp(s log(R_0^T R_1)),     s = 0 ... 1

    A line runs from a random configuration to the pose of another one within 0.8 rad of it. Every line is followed by
    damped steps, from answer to answer; it is kept if every pose is solved inside the limits and no joint moves by more
    than 0.1 rad (slides: typical lengths) from a point to the next. So each line that is left can be followed without a
    jump by an arm that starts at ``q[:, 0]``.

    Args:
        robot: the robot, n joint variables.
        paths: how many.
        points: of each line, at least 2.
        seed: of the random configurations.

    Raises:
        RobotError: fewer lines than wanted were found; arms with less than six joints can follow hardly any.

    Example:
        >>> import ikgrad as ik
        >>> lines = straight_lines(ik.load_robot("ur5e"), 3, 50, seed=0)
        >>> tuple(lines.q.shape), bool(lines.T[:, :, :3, 3].diff(n=2, dim=1).abs().max() < 1e-12)
        ((3, 50, 6), True)
    """
    assert paths >= 1
    assert points >= 2
    start = sample_configurations(robot, _CANDIDATES * paths, seed=seed).to("cpu", torch.float64)
    generator = torch.Generator().manual_seed(seed)
    unit = joint_units(robot)
    low, high = (limit.to(start) for limit in robot.sampling_range)
    move = _SPAN * unit * (2 * torch.rand(start.shape, dtype=start.dtype, generator=generator) - 1)
    ends = forward_kinematics(robot, torch.stack([start, (start + move).clamp(low, high)]))
    T = _between(ends[0], ends[1], torch.linspace(0, 1, points, dtype=torch.float64))
    q, followed = _follow(robot, start, T)
    kept = followed & ((q.diff(dim=1).abs() / unit).amax(dim=(1, 2)) <= _SMOOTH)
    if int(kept.sum()) < paths:
        raise RobotError(
            f"robot '{robot.name}' can follow only {int(kept.sum())} of {len(kept)} random straight lines, "
            f"{paths} wanted"
        )
    return Lines(q[kept][:paths], T[kept][:paths])


def joint_units(robot: Robot) -> Tensor:
    """(n,) what counts as one radian: 1 rad of a turning joint, the arm's typical length [m] of a slide."""
    one = torch.ones(robot.dof, dtype=torch.float64)
    return one.masked_fill(~robot.revolute.cpu(), typical_length(robot))


def _between(T_start: Tensor, T_end: Tensor, s: Tensor) -> Tensor:
    """(P, 4, 4) and (P, 4, 4) -> (P, points, 4, 4)."""
    T = T_start[:, None].repeat(1, len(s), 1, 1)
    R = T_start[:, :3, :3]
    vector = log_rotation(R.mT @ T_end[:, :3, :3])  # (P, 3)
    angle = vector.norm(dim=-1)[:, None]
    axis = vector / angle.clamp_min(1e-12)
    half = (s * angle / 2)[..., None]  # (P, points, 1)
    turn = matrix_from_quat_wxyz(torch.cat([half.cos(), half.sin() * axis[:, None]], dim=-1))
    T[..., :3, :3] = R[:, None] @ turn
    T[..., :3, 3] = T_start[:, None, :3, 3] + s[:, None] * (T_end - T_start)[:, None, :3, 3]
    return T


def _follow(robot: Robot, q: Tensor, T: Tensor) -> tuple[Tensor, Tensor]:
    """(P, points, n) answers from answer to answer, and (P,) whether all of them are solutions."""
    answers, solved = [], torch.ones(len(q), dtype=torch.bool)
    for now in T.unbind(dim=1):
        found = damped_steps(robot, now, q, steps=_STEPS)
        q, solved = found.q, solved & (found.error.norm(dim=-1) <= _SOLVED)
        answers.append(q)
    return torch.stack(answers, dim=1), solved


__all__ = ["Lines", "clear_paths", "joint_units", "smooth_paths", "straight_lines"]
