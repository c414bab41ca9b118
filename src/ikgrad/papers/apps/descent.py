"""APPS with every iterate kept, for curves, and with a learning rate of its own for each row."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ikgrad.robot import Robot
from ikgrad.solvers.apps import Apps
from ikgrad.solvers.base import State
from ikgrad.solvers.loop import run
from ikgrad.solvers.problem import Problem


@dataclass(frozen=True, eq=False)
class RowRates:
    """The same descent for every row, each with its own learning rate: many rates cost as much as one.

    Args:
        apps: the settings; its ``eta`` must be 1, because the rows' rates scale the gradient.
        eta: (B,) learning rates.
    """

    apps: Apps
    eta: Tensor

    restarts = False

    @property
    def max_steps(self) -> int:
        """Evaluations allowed for one row."""
        return self.apps.max_steps

    def init(self, problem: Problem, q: Tensor) -> State:
        """Evaluate the starts; from here on a row carries its number and its rate."""
        own = {"row": torch.arange(len(q)), "eta": self.eta[:, None]}
        return _scaled(self.apps.init(problem, q), own)

    def step(self, problem: Problem, state: State) -> State:
        """One step of `Apps` along each row's own multiple of the gradient."""
        own = {key: state.memory[key] for key in ("row", "eta")}
        return _scaled(self.apps.step(problem, state), own)


def descend(robot: Robot, T_target: Tensor, q0: Tensor, apps: Apps, eta: Tensor | None = None) -> list[Tensor]:
    """Paths of the descent through joint space, one per row, joint ranges ignored.

    Args:
        robot: the robot, n joint variables.
        T_target: (B, 4, 4) goals [m].
        q0: (B, n) starts [rad].
        apps: the settings.
        eta: (B,) learning rates; default: ``apps.eta`` for all.

    Returns:
        B tensors (k, n) [rad]: every iterate from the start on, the last one included; k is the iteration count.
    """
    rates = torch.full((len(q0),), apps.eta, dtype=q0.dtype) if eta is None else eta.to(q0)
    endless = torch.full((robot.dof,), math.inf, dtype=q0.dtype)
    key = torch.zeros(len(q0), dtype=torch.int64)
    problem = Problem(robot, T_target, key, -endless, endless, mask=None, tol_pos=1.0, tol_rot=1.0)
    states: list[State] = []
    run(RowRates(replace(apps, eta=1.0), rates), problem, q0, watch=states.append)
    row = torch.cat([state.memory["row"] for state in states])
    q = torch.cat([state.q for state in states])
    return [q[row == k] for k in range(len(q0))]


def _scaled(state: State, own: dict[str, Tensor]) -> State:
    return replace(state, memory={"gradient": state.memory["gradient"] * own["eta"], **own})
