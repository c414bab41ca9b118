"""The shape of a method: a frozen dataclass of settings with ``init`` and ``step``; `loop` does the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.solvers.problem import Problem


@dataclass(frozen=True, eq=False)
class State:
    """One iterate of every row, evaluated.

    Attributes:
        q: (B, n)
        position_error: (B,) [m]
        rotation_error: (B,) [rad]
        done: (B,) the method stops here, for better or worse.
        memory: tensors with B rows that the method wants back at the next step.
    """

    q: Tensor
    position_error: Tensor
    rotation_error: Tensor
    done: Tensor
    memory: Mapping[str, Tensor] = field(default_factory=dict)

    def rows(self, index: Tensor) -> State:
        """The state of some of the rows."""
        memory = {name: value[index] for name, value in self.memory.items()}
        return State(self.q[index], self.position_error[index], self.rotation_error[index], self.done[index], memory)


class Solver(Protocol):
    """An IK method. `init` evaluates the start (iteration 1), each `step` moves and evaluates once more."""

    @property
    def max_steps(self) -> int:
        """Evaluations allowed for one row."""

    @property
    def restarts(self) -> bool:
        """True if the method draws starts of its own, so that the answer need not be near ``q0``."""

    def init(self, problem: Problem, q: Tensor) -> State:
        """Evaluate (B, n) starts."""

    def step(self, problem: Problem, state: State) -> State:
        """Move every row once and evaluate it."""


def check_positive(solver: object, **values: float) -> None:
    """Refuse settings that are not positive numbers."""
    for name, value in values.items():
        if not value > 0:
            raise ConfigError(f"{type(solver).__name__}: {name} must be positive, got {value}")
