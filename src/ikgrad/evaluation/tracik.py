"""TRAC-IK's protocol: what is the inverter worth as a start of an exact solver?"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from ikgrad.data import sample_configurations
from ikgrad.evaluation.errors import measure, row_errors
from ikgrad.evaluation.inverters import call, robot_of
from ikgrad.evaluation.records import PLAIN_STEPS, Evaluation, Protocol, Row
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot
from ikgrad.solvers.solution import IKSolution
from ikgrad.solvers.solve import solve_ik

TOLERANCE = 1e-5  # [m] and [rad]
_ROUNDS = 5  # turns of each kind of start; the shortest counts
TRACIK: dict[str, dict[str, Any]] = {
    robot: {
        "source": f"README of bitbucket.org/traclabs/trac_ik, version 1.4.6, '{chain}'",
        "solved": solved,
        "mean_milliseconds": ms,
    }
    for robot, chain, solved, ms in (
        ("panda", "Franka Emika Panda", 0.9970, 0.38),
        ("iiwa14", "KUKA LBR iiwa 14 R820", 0.9984, 0.31),
    )
}
"""What TRAC-IK's authors publish, by robot."""

_Start = Callable[[Tensor], Tensor | None]


@dataclass(frozen=True)
class TracIK(Protocol):
    """Poses of 10,000 random configurations, solved to 1e-5 m and 1e-5 rad inside the limits, from three starts.

    The engine's own starts (none is given); the middle of every joint's range, which is where TRAC-IK starts; and the
    answer of the inverter, which sees the same middle as its present joints. The solver is `ikgrad.solve_ik`, which
    goes on with random starts where the first one fails. The time of a guess counts. Solved is what plain forward
    kinematics says, not what the solver says.

    Differences:
        TRAC-IK's 1e-5 is of each of the six errors for itself; here it is of the length of three, which is stricter. It
        answers one pose a call and gives up after 5 ms; here all poses go in one call without a limit of time, so that
        its published times are no rivals of these (`ikgrad bench ik --protocol tracik` asks pose by pose).

    Source:
        Beeson and Ames, TRAC-IK: An open-source library for improved solving of generic inverse kinematics, Humanoids
        2015; settings as in the README of bitbucket.org/traclabs/trac_ik.

    Example:
        >>> import ikgrad as ik
        >>> found = TracIK(count=50).run(ik.UnrolledInverter(ik.load_robot("ur5e"), width=8))
        >>> [row.extra["solved"] for row in found.rows]
        [1.0, 1.0, 1.0]
    """

    name: ClassVar[str] = "tracik"
    poses: ClassVar[int] = 10_000

    def run(
        self, inverter: nn.Module, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = PLAIN_STEPS
    ) -> Evaluation:
        """See `Protocol.run`; the solver decides on its steps here, so that both numbers of steps are not looked at."""
        robot = robot_of(inverter)
        T = forward_kinematics(robot.detach(), sample_configurations(robot, self._number, seed=self._row_seed).cpu())
        low, high = (limit.to(T) for limit in robot.sampling_range)
        middle = ((low + high) / 2).expand(len(T), -1)
        starts: dict[str, _Start] = {
            "solve_ik, its own starts": lambda T: None,
            "solve_ik from the middle of the ranges": lambda T: middle,
            "solve_ik from the inverter": lambda T: call(inverter, T, middle),
        }
        published = TRACIK.get(robot.name, {})
        return Evaluation(
            robot.name,
            robot.fingerprint,
            "tracik, 1e-5 m and 1e-5 rad",
            len(T),
            self.seed,
            torch.get_num_threads(),
            _race(robot, T, starts, self.seed),
            protocol=self.name,
            notes=(_note(published),) if published else (),
            published=published,
        )


@torch.no_grad()
def _race(robot: Robot, T: Tensor, starts: dict[str, _Start], seed: int) -> tuple[Row, ...]:
    """The kinds of start take turns; the first turn loads what is loaded once."""

    def solve(start: _Start) -> IKSolution:
        return solve_ik(robot.detach(), T, q0=start(T), tol_pos=TOLERANCE, tol_rot=TOLERANCE, seed=seed)

    answers = {name: solve(start) for name, start in starts.items()}
    seconds = dict.fromkeys(starts, float("inf"))
    for _ in range(_ROUNDS):
        for name, start in starts.items():
            begun = time.perf_counter()
            solve(start)
            seconds[name] = min(seconds[name], time.perf_counter() - begun)
    first = next(iter(seconds.values()))
    rows = []
    for name, answer in answers.items():
        steps = answer.steps.double()
        extra = {
            "solved": float(row_errors(robot, answer.q, T).within(TOLERANCE, TOLERANCE).double().mean()),
            "steps": float(steps.mean()),
            "steps_99": float(steps.quantile(0.99)),
            "time_ratio": seconds[name] / first,
        }
        rows.append(Row(name, measure(robot, answer.q, T), seconds[name] / len(T) * 1e6, extra))
    return tuple(rows)


def _note(published: dict[str, Any]) -> str:
    return (
        f"TRAC-IK: {100 * published['solved']:.2f} % solved in {published['mean_milliseconds']} ms on average, one "
        f"pose a call, 5 ms at most; published, not measured here ({published['source']})."
    )


__all__ = ["TOLERANCE", "TRACIK", "TracIK"]
