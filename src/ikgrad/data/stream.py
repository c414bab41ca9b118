"""Samples without end, made while a network learns: no row is seen twice, and nothing is kept.

Batch k of a stream depends on the seed and on k alone, so that a training that goes on needs to remember k and nothing
else, and several processes can share a batch, each making its own rows of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from ikgrad.data.schemes import Samples
from ikgrad.errors import ConfigError
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps, typical_length

LOCAL = 0.5  # rad a joint: what "near" means in the tables of this project
_TEACHER_STEPS = 12  # 0.2 % of panda's local rows are not solved by then, nor by 40
_REACHED = 1e-6


@dataclass(frozen=True)
class TaskStream:
    """An arm stands at ``q_current`` and is asked for a pose: endless batches of such rows.

    The present joints are uniform in the limits. In the *local* task the target is the pose of joints that are uniform
    within ``spread`` of them and inside the limits; in the *global* task (``spread=None``) it is the pose of any joints
    in the limits.

    Attributes:
        robot: the robot, n joint variables.
        batch_size: rows a batch.
        spread: largest change of a joint [rad; slides: times the arm's typical length]; None: the global task.
        label: what ``q`` holds: ``"made"``: the joints that the target was made from; ``"solver"``: the joints that
            Levenberg-Marquardt reaches from the present ones, the least movement, on the same branch. Where it gets
            stuck (2 rows in 1,000) these are the ones that the target was made from.
        seed: of all draws.

    Raises:
        ConfigError: a setting is out of range; the message says which.

    Example:
        >>> import ikgrad as ik
        >>> stream = TaskStream(ik.load_robot("ur5e"), batch_size=100)
        >>> T, q, q_current = stream.batch(7)
        >>> bool(((q - q_current).abs() <= 0.5).all())
        True
        >>> torch.equal(T, stream.batch(7).T)
        True
    """

    robot: Robot
    batch_size: int = 1024
    spread: float | None = LOCAL
    label: Literal["made", "solver"] = "made"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.batch_size < 1:
            raise ConfigError(f"batch_size must be at least 1, got {self.batch_size}")
        if self.spread is not None and not 0 < self.spread < float("inf"):
            raise ConfigError(f"spread must be positive and finite, or None for the global task, got {self.spread}")
        if self.label not in ("made", "solver"):
            raise ConfigError(f"label must be 'made' or 'solver', got '{self.label}'")
        if not 0 <= self.seed < 2**31:
            raise ConfigError(f"seed must be in [0, 2^31), got {self.seed}")

    @property
    def task(self) -> str:
        """What the rows ask for, in words."""
        return "global" if self.spread is None else f"local, {self.spread:g} rad"

    def batch(self, number: int, *, rows: slice = slice(None)) -> Samples:
        """Rows of batch ``number``, float64 on the CPU.

        Args:
            number: 0 or more.
            rows: which of them to make; a part of a batch has the very values that the whole has there.

        Raises:
            ConfigError: a negative number.
        """
        if not 0 <= number < 2**32:
            raise ConfigError(f"number of a batch must be in [0, 2^32), got {number}")
        robot = self.robot.detach()
        generator = torch.Generator().manual_seed(_mix(self.seed << 32 | number))
        unit = torch.rand(2, self.batch_size, robot.dof, dtype=torch.float64, generator=generator)
        unit = unit[:, rows]
        low, high = (limit.to("cpu", torch.float64) for limit in robot.sampling_range)
        q_current = low + (high - low) * unit[0]
        if self.spread is not None:
            low, high = self._around(q_current)
        q = low + (high - low) * unit[1]
        T = forward_kinematics(robot, q)
        return Samples(T, self._teach(T, q, q_current), q_current)

    def __iter__(self) -> Iterator[Samples]:
        number = 0
        while True:
            yield self.batch(number)
            number += 1

    def _around(self, q: Tensor) -> tuple[Tensor, Tensor]:
        assert self.spread is not None
        slides = ~self.robot.revolute.to("cpu")
        reach = torch.full_like(q[0], self.spread).masked_fill(slides, self.spread * typical_length(self.robot))
        q_min, q_max = (limit.to("cpu", torch.float64) for limit in (self.robot.q_min, self.robot.q_max))
        return torch.maximum(q - reach, q_min), torch.minimum(q + reach, q_max)

    def _teach(self, T: Tensor, q: Tensor, q_current: Tensor) -> Tensor:
        if self.label == "made":
            return q
        found = damped_steps(self.robot, T, q_current, steps=_TEACHER_STEPS)
        reached = found.error.norm(dim=-1, keepdim=True) < _REACHED
        return torch.where(reached, found.q, q)


def _mix(key: int) -> int:
    """A 64-bit hash (splitmix64's finaliser): neighbouring numbers give unrelated generators."""
    mask = 2**64 - 1
    key = (key + 0x9E3779B97F4A7C15) & mask
    key = ((key ^ key >> 30) * 0xBF58476D1CE4E5B9) & mask
    key = ((key ^ key >> 27) * 0x94D049BB133111EB) & mask
    return (key ^ key >> 31) >> 1  # torch takes seeds below 2^63 on every platform


__all__ = ["LOCAL", "TaskStream"]
