"""The methods that can follow a dragged target. Each says what it did; none is helped where it fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ikgrad.networks.storage import AnyInverter
from ikgrad.robot import Robot
from ikgrad.solvers.apps import Apps
from ikgrad.solvers.base import Solver
from ikgrad.solvers.damped import damped_steps
from ikgrad.solvers.judge import judge
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.newton import NewtonRaphson
from ikgrad.solvers.question import ask
from ikgrad.solvers.solution import Reason
from ikgrad.solvers.solve import solve_ik
from ikgrad.view.approach import approach
from ikgrad.view.race import answers

Mask = Sequence[float] | None
TOLERANCE = 1e-6  # m and rad
CORRECTIONS = 3  # damped steps after an inverter
PORTION = 15  # APPS gradients between two pictures
PATIENCE = 1000  # APPS gradients for one target: the paper's limit

_QUICK = LevenbergMarquardt(max_starts=4)  # while the target moves: a full search may take a tenth of a second
_FULL = LevenbergMarquardt()
_APPROACH = {True: 60, False: 6}  # towards a target that is not reached; while it moves the next answer goes on


@dataclass(frozen=True, eq=False)
class Step:
    """Where a method has led.

    Attributes:
        q: (n,) joints to show; the present ones if the target is no transform.
        code: of `ikgrad.Reason`.
        said: what the method has to say of a target that it does not meet; empty: the reason's own sentence.
        more: it is not at its end, and goes on from ``q``.
        exact: it means to meet the target; an inverter comes near.
    """

    q: Tensor
    code: int
    said: str = ""
    more: bool = False
    exact: bool = True


class Method(Protocol):
    """A way from the present joints to a target."""

    def __call__(self, robot: Robot, T_target: Tensor, q: Tensor, *, mask: Mask, thorough: bool) -> Step:
        """Go there.

        Args:
            robot: the robot, n joint variables.
            T_target: (4, 4) wanted pose [m].
            q: (n,) present joints.
            mask: which errors count, see `ikgrad.solve_ik`.
            thorough: take the time that it takes; False while the target moves.
        """


def levenberg_marquardt(robot: Robot, T_target: Tensor, q: Tensor, *, mask: Mask, thorough: bool) -> Step:
    """`ikgrad.solve_ik` with its starts; where there is no solution, as near as steps downhill lead."""
    found = solve_ik(robot, T_target, q0=q, solver=_FULL if thorough else _QUICK, mask=mask)
    code = int(found.reason_code)
    if code == Reason.converged:
        return Step(found.q, code)
    if code != Reason.invalid_target:
        q = approach(robot, T_target, q, position_only=mask is not None, steps=_APPROACH[thorough])
    return Step(q, code)


def newton_raphson(robot: Robot, T_target: Tensor, q: Tensor, *, mask: Mask, thorough: bool) -> Step:
    """Full Newton steps from the present joints, and from nowhere else."""
    solver = NewtonRaphson(max_steps=100 if thorough else 20)
    said = f"Newton-Raphson has not arrived after {solver.max_steps} steps from here"
    return _plain(solver, robot, T_target, q, mask, said)


class Descent:
    """APPS, some gradients at a time, so that its way can be watched; at most 1,000 for one target."""

    def __init__(self) -> None:
        self._target: Tensor | None = None
        self._spent = 0

    def __call__(self, robot: Robot, T_target: Tensor, q: Tensor, *, mask: Mask, thorough: bool) -> Step:
        """The next gradients from the present joints."""
        if self._target is None or not torch.equal(T_target, self._target):
            self._target, self._spent = T_target.clone(), 0
        self._spent += PORTION
        more = self._spent < PATIENCE
        said = f"APPS {'is on its way' if more else 'has not arrived'} after {self._spent:,} gradients"
        step = _plain(Apps(max_steps=PORTION + 1), robot, T_target, q, mask, said)
        return Step(step.q, step.code, step.said, more=more and step.code == Reason.no_convergence)


@dataclass(frozen=True, eq=False)
class Network:
    """An inverter's answer from the present joints, and damped steps after it if they are wanted.

    Attributes:
        inverter: of this robot.
        corrections: damped steps.
    """

    inverter: AnyInverter
    corrections: int = 0

    def __call__(self, robot: Robot, T_target: Tensor, q: Tensor, *, mask: Mask, thorough: bool) -> Step:
        """One answer. It is for a whole pose, whatever the mask says."""
        problem, _, valid = ask(
            robot, T_target, q0=q, tol_pos=TOLERANCE, tol_rot=TOLERANCE, limits=True, mask=mask, seed=0
        )
        if not bool(valid):
            return Step(q, Reason.invalid_target)
        answer = answers(self.inverter, T_target, q)[-1].clamp(robot.q_min, robot.q_max)
        if self.corrections:
            answer = damped_steps(robot, T_target, answer, steps=self.corrections).q
        steps = torch.zeros(1, dtype=torch.int64)
        found = judge(NewtonRaphson(), problem, answer[None], steps, valid, torch.float64)  # measured, not solved
        after = f" and {self.corrections} damped steps" if self.corrections else ""
        said = f"the network's own answer{after}, which comes near and no nearer"
        return Step(answer, int(found.reason_code), said, exact=False)


def methods(inverter: AnyInverter | None = None) -> dict[str, Callable[..., Step]]:
    """The methods by the names that the page shows, the default first.

    Args:
        inverter: of the robot, if there is one.

    Example:
        >>> list(methods())
        ['Levenberg-Marquardt', 'Newton-Raphson', 'APPS']
    """
    found: dict[str, Callable[..., Step]] = {
        "Levenberg-Marquardt": levenberg_marquardt,
        "Newton-Raphson": newton_raphson,
        "APPS": Descent(),
    }
    if inverter is not None:
        found["neural inverter"] = Network(inverter)
        found[f"neural inverter + {CORRECTIONS} damped steps"] = Network(inverter, CORRECTIONS)
    return found


def _plain(solver: Solver, robot: Robot, T_target: Tensor, q: Tensor, mask: Mask, said: str) -> Step:
    """A method without starts of its own; its iterate is shown, wherever it is."""
    found = solve_ik(robot, T_target, q0=q, solver=solver, mask=mask)
    code = int(found.reason_code)
    if code == Reason.joint_limits:
        said = "the pose is met, but with a joint outside its limits, which this method does not know"
    return Step(q if code == Reason.invalid_target else found.q, code, said)


__all__ = ["CORRECTIONS", "Descent", "Method", "Network", "Step", "levenberg_marquardt", "methods", "newton_raphson"]
