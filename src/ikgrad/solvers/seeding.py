"""Starts for `solve_ik` from anything that guesses joints for poses: a neural inverter, a table, a closed form.

A guess costs time and saves steps. `scripts/bench_seeds.py` says what pays; on the CPU the compiled solver's own table
of configurations is hard to beat, since a guess from it costs less than one damped step.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ikgrad.errors import RobotError, ShapeError
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.robot import Robot

Seeder = Callable[[Tensor], Tensor]
"""(..., 4, 4) poses -> (..., n) joints, or (..., k, n): k guesses a pose. A ``torch.nn.Module`` may be one."""


@torch.no_grad()
def seeds(robot: Robot, T: Tensor, seeder: Seeder) -> Tensor:
    """Where to start: the guess, or of several the one whose pose is nearest.

    Nearest is the smallest ``|position error / L|^2 + |rotation error|^2``, L the robot's typical length. Joints that
    are not finite are replaced by the middle of their range: a bad guess must not make a row fail.

    Args:
        robot: the robot, n joint variables.
        T: (..., 4, 4) poses [m].
        seeder: what guesses; it is called once, with poses in the ``dtype`` that it names as an attribute, if any.

    Returns:
        (..., n) float64.

    Raises:
        RobotError: the seeder has a ``robot`` of its own, which is another one.
        ShapeError: it returned another shape.
    """
    own = getattr(seeder, "robot", robot)
    if own.fingerprint != robot.fingerprint:
        raise RobotError(
            f"the seeder is for robot '{own.name}' ({own.fingerprint}), not '{robot.name}' ({robot.fingerprint})"
        )
    dtype = getattr(seeder, "dtype", T.dtype)
    q = seeder(T.detach().to(dtype)).to(torch.float64)
    shape = (*T.shape[:-2], robot.dof)
    several = q.ndim == len(shape) + 1 and (*q.shape[:-2], q.shape[-1]) == shape and q.shape[-2] > 0
    if q.shape != shape and not several:
        raise ShapeError(
            f"the seeder returned {tuple(q.shape)} for poses {tuple(T.shape)}; "
            f"expected {shape}, or k guesses each, {(*shape[:-1], 'k', robot.dof)}"
        )
    low, high = (limit.to(q) for limit in robot.sampling_range)
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
