"""Where bad input to `ikgrad.optimize_trajectory` is refused; every message names the entry."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.collision.checks import check_bound, check_finite, check_link_radius
from ikgrad.collision.links import link_layout
from ikgrad.collision.obstacles import Capsules, Obstacles, Spheres
from ikgrad.errors import ConfigError, ShapeError
from ikgrad.kinematics import check_q
from ikgrad.robot import Robot


def check_ends(robot: Robot, q_start: Tensor, q_goal: Tensor) -> tuple[Tensor, Tensor]:
    """Both ends, broadcast; refuses what is not (..., n), not finite or outside the limits."""
    for name, q in (("q_start", q_start), ("q_goal", q_goal)):
        check_q(robot, q, name)
        check_finite(name, q)
        _check_limits(robot, name, q)
    if q_start.dtype != q_goal.dtype or q_start.device != q_goal.device:
        raise ShapeError(
            f"q_start and q_goal must have one dtype and device, got {q_start.dtype} on {q_start.device} and "
            f"{q_goal.dtype} on {q_goal.device}"
        )
    try:
        start, goal = torch.broadcast_tensors(q_start.detach(), q_goal.detach())
    except RuntimeError as error:
        raise ShapeError(f"q_start {tuple(q_start.shape)} and q_goal {tuple(q_goal.shape)} do not broadcast") from error
    return start, goal


def _check_limits(robot: Robot, name: str, q: Tensor) -> None:
    slack = slack_of(q.dtype)
    low, high = robot.q_min.to(q), robot.q_max.to(q)
    for side, limit, bad in (("below", low, q < low - slack), ("above", high, q > high + slack)):
        if bool(bad.any()):
            joint = int(torch.nonzero(bad)[0, -1])
            which = "lower" if side == "below" else "upper"
            demand = f"must not lie {side} the {which} limit {limit[joint].item():g} of '{robot.joint_names[joint]}'"
            check_bound(name, q, demand, bad)


def slack_of(dtype: torch.dtype) -> float:
    """How far beyond a limit rounding may carry a joint [rad or m]."""
    return 1e-9 if dtype == torch.float64 else 64 * torch.finfo(dtype).eps


def check_settings(
    robot: Robot,
    obstacles: Obstacles,
    link_radius: Tensor | float,
    margin: float,
    duration: float | None,
    counts: dict[str, tuple[int, int]],
) -> None:
    """Refuse settings that make no sense; ``counts`` is name to (value, least value)."""
    if not isinstance(obstacles, Spheres | Capsules):
        raise ShapeError(f"obstacles must be Spheres or Capsules of ikgrad.collision, got {type(obstacles).__name__}")
    if obstacles.radii.ndim != 1:
        shape = tuple(obstacles.radii.shape)
        raise ShapeError(f"obstacles must be the same K for all rows, got radii of shape {shape}; plan scene by scene")
    check_link_radius(link_radius, len(link_layout(robot).start))
    if not (math.isfinite(margin) and margin >= 0):
        raise ConfigError(f"margin must be a finite number that is not negative, got {margin}")
    if duration is not None and not (math.isfinite(duration) and duration > 0):
        raise ConfigError(f"duration must be a positive finite number, got {duration}")
    for name, (value, least) in counts.items():
        if value < least:
            raise ConfigError(f"{name} must be at least {least}, got {value}")
