"""Answers without present joints, from an inverter that needs them: try several, keep the best.

An inverter for nearby targets is lost where the target is far. It is also so quick that it may begin at several
places; which of its answers is good, forward kinematics tells.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ikgrad.data.configurations import sample_configurations
from ikgrad.errors import ConfigError
from ikgrad.networks.local import IncrementInverter
from ikgrad.solvers.damped import damped_steps


class BestOfStarts(nn.Module):
    """Of k answers from k scattered starts, the one whose pose misses the target by least.

    The starts are the same for all poses. What is missing counts as ``|position / length|^2 + |rotation|^2``, length
    the arm's typical one. Also a seeder for `ikgrad.solve_ik`.

    Args:
        inverter: starts from present joints.
        starts: k, how many; time grows with it.
        seed: of the starts, which are uniform in the limits.

    Raises:
        ConfigError: fewer than one start.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 50, seed=1))
        >>> BestOfStarts(ik.UnrolledInverter(robot), starts=8)(T).shape
        torch.Size([50, 6])
    """

    feedback = False
    q_starts: Tensor

    def __init__(self, inverter: IncrementInverter, *, starts: int = 8, seed: int = 0):
        super().__init__()
        if starts < 1:
            raise ConfigError(f"starts must be at least 1, got {starts}")
        self.robot, self.inverter = inverter.robot, inverter
        drawn = sample_configurations(self.robot, starts, seed=seed)
        self.register_buffer("q_starts", drawn.to("cpu", torch.float64), persistent=False)

    def forward(self, T: Tensor) -> Tensor:
        """Joint values for poses.

        Args:
            T: (..., 4, 4) wanted poses [m].

        Returns:
            (..., n) joint values inside the limits [rad or m], of the dtype of ``T``.
        """
        rows = T.reshape(-1, 4, 4)
        starts = len(self.q_starts)
        q = self.inverter(rows[:, None], self.q_starts.to(T))  # (B, k, n)
        flat = q.reshape(-1, self.robot.dof).detach().double()
        targets = rows.detach().double().repeat_interleave(starts, dim=0)
        missing = damped_steps(self.robot, targets, flat).error.square().sum(dim=-1)
        best = missing.reshape(-1, starts).argmin(dim=-1)
        chosen = q.take_along_dim(best[:, None, None], dim=1)[:, 0]
        return chosen.reshape(*T.shape[:-2], self.robot.dof)

    def extra_repr(self) -> str:
        """How many, for ``print(inverter)``."""
        return f"starts={len(self.q_starts)}"


__all__ = ["BestOfStarts"]
