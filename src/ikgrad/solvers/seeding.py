"""Starts for `solve_ik` from anything that guesses joints for poses: a neural inverter, a table, a closed form.

A guess costs time and saves steps. `scripts/bench_seeds.py` says what pays; on the CPU the compiled solver's own table
of configurations is hard to beat, since a guess from it costs less than one damped step.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, RobotError, ShapeError
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.robot import Robot

Seeder = Callable[..., Tensor]
"""(..., 4, 4) poses -> (..., n) joints, or (..., k, n): k guesses a pose. A ``torch.nn.Module`` may be one.

If it has an attribute ``feedback`` that is true, as inverters that start from the present joints have, it is called
with these as a second argument: with ``q0``, or with the middle of the ranges."""


@torch.no_grad()
def seeds(robot: Robot, T: Tensor, seeder: Seeder, q0: Tensor | None = None) -> Tensor:
    """Where to start: the guess, or of several the one whose pose is nearest.

    Nearest is the smallest ``|position error / L|^2 + |rotation error|^2``, L the robot's typical length. Joints that
    are not finite are replaced by the middle of their range: a bad guess must not make a row fail.

    Args:
        robot: the robot, n joint variables.
        T: (..., 4, 4) poses [m].
        seeder: what guesses; it is called once, with poses in the ``dtype`` that it names as an attribute, if any.
        q0: (..., n) present joints, for a seeder that looks at them.

    Returns:
        (..., n) float64.

    Raises:
        RobotError: the seeder has a ``robot`` of its own, which is another one.
        ConfigError: there is ``q0``, and the seeder does not look at it.
        ShapeError: it returned another shape.
    """
    own = getattr(seeder, "robot", robot)
    if own.fingerprint != robot.fingerprint:
        raise RobotError(
            f"the seeder is for robot '{own.name}' ({own.fingerprint}), not '{robot.name}' ({robot.fingerprint})"
        )
    feedback = getattr(seeder, "feedback", False)
    if q0 is not None and not feedback:
        raise ConfigError(
            "give q0 or a seeder, not both: each says where to start, and this seeder does not look at q0"
        )
    dtype = getattr(seeder, "dtype", T.dtype)
    low, high = (limit.to(T.device, torch.float64) for limit in robot.sampling_range)
    present = ((low + high) / 2 if q0 is None else q0.detach()).to(dtype)
    given = T.detach().to(dtype)
    q = (seeder(given, present) if feedback else seeder(given)).to(torch.float64)
    shape = (*T.shape[:-2], robot.dof)
    several = q.ndim == len(shape) + 1 and (*q.shape[:-2], q.shape[-1]) == shape and q.shape[-2] > 0
    if q.shape != shape and not several:
        raise ShapeError(
            f"the seeder returned {tuple(q.shape)} for poses {tuple(T.shape)}; "
            f"expected {shape}, or k guesses each, {(*shape[:-1], 'k', robot.dof)}"
        )
    q = torch.where(q.isfinite(), q, (low + high) / 2)
    return _nearest(robot, T.detach().to(torch.float64), q) if several else q


def _nearest(robot: Robot, T: Tensor, q: Tensor) -> Tensor:
    """The best (..., n) of (..., k, n) guesses."""
    robot = robot.detach()
    e = pose_error(forward_kinematics(robot, q), T[..., None, :, :])
    merit = (e[..., :3] / robot.length).square().sum(dim=-1) + e[..., 3:].square().sum(dim=-1)
    best = merit.nan_to_num(torch.inf).argmin(dim=-1)
    return q.take_along_dim(best[..., None, None], dim=-2)[..., 0, :]


__all__ = ["Seeder", "seeds"]
