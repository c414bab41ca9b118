"""Samples of configurations; batched FK turns them into poses."""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, RobotError
from ikgrad.robot import Robot


def sample_configurations(robot: Robot, count: int, *, seed: int, sobol: bool = False) -> Tensor:
    """Configurations spread over the joint limits, independently uniform or as a scrambled Sobol sequence.

    Unlimited angles are drawn from (-pi, pi], unlimited slides from [-1, 1] m.

    Args:
        robot: the robot, n joint variables.
        count: how many.
        seed: the same seed gives the same configurations.
        sobol: a low-discrepancy sequence: covers the box more evenly than independent draws.

    Returns:
        (count, n) of the robot's dtype and device.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> q = ik.sample_configurations(robot, 100, seed=0)
        >>> bool(((robot.q_min <= q) & (q <= robot.q_max)).all())
        True
    """
    if count < 0:
        raise ConfigError(f"count must not be negative, got {count}")
    if sobol:
        if robot.dof > torch.quasirandom.SobolEngine.MAXDIM:
            raise RobotError(f"robot '{robot.name}' has {robot.dof} joints, too many for a Sobol sequence")
        engine = torch.quasirandom.SobolEngine(robot.dof, scramble=True, seed=seed)
        unit = engine.draw(count, dtype=torch.float64)
    else:
        generator = torch.Generator().manual_seed(seed)
        unit = torch.rand(count, robot.dof, dtype=torch.float64, generator=generator)
    low, high = (limit.to("cpu", torch.float64) for limit in robot.sampling_range)
    q = high - unit * (high - low)  # unit is in [0, 1): the upper end is included, so -pi never appears
    return q.to(robot.device, robot.dtype)
