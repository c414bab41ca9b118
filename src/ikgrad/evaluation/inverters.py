"""An inverter on a task, before and after solver steps, beside plain damped steps that take as long."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn

from ikgrad.data import TaskStream
from ikgrad.errors import ConfigError, RobotError
from ikgrad.evaluation.errors import Errors, measure
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps

_REPEATS = 5  # timings; the shortest counts
_MOST_STEPS = 200  # of the baseline that takes as long as the inverter


@dataclass(frozen=True)
class Row:
    """One method on one task.

    Attributes:
        method: in words.
        errors: of its answers.
        microseconds: a pose, all poses at once; the shortest of five runs.
    """

    method: str
    errors: Errors
    microseconds: float


@dataclass(frozen=True)
class Evaluation:
    """Methods side by side on the same rows.

    Attributes:
        robot: its name.
        fingerprint: of the robot.
        task: in words.
        count: rows.
        seed: of the rows.
        threads: torch's, at the time.
        rows: the inverter, the inverter and solver steps, then plain damped steps from the present joints.
    """

    robot: str
    fingerprint: str
    task: str
    count: int
    seed: int
    threads: int
    rows: tuple[Row, ...]

    def record(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    def lines(self) -> list[str]:
        """A Markdown table, line by line: percentiles are median / 95th / 99.9th."""
        head = (
            "method",
            "position [mm]",
            "rotation [deg]",
            "inside",
            "1 mm, 0.01 rad",
            "1e-6 m, 1e-6 rad",
            "us a pose",
        )
        table = [head, ("---",) * len(head), *map(_cells, self.rows)]
        title = f"{self.robot}, task {self.task}, {self.count:,} poses, seed {self.seed}, {self.threads} threads"
        return [title, "", *("| " + " | ".join(cells) + " |" for cells in table)]


def evaluate(
    inverter: nn.Module, task: TaskStream, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
) -> Evaluation:
    """Measure an inverter on batch 0 of a task, and what plain damped steps do with the same rows.

    Args:
        inverter: with a ``robot``; called with poses and present joints, or with poses alone if its ``feedback`` is
            False.
        task: rows to answer; take a seed that it was not trained with.
        solver_steps: also after 1 to so many damped steps from its answers.
        plain_steps: numbers of plain damped steps from the present joints. One more row takes as many steps as fit
            into the time of the inverter.

    Returns:
        Errors and times, in the order: inverter, after each solver step, plain steps.

    Raises:
        RobotError: the task is for another robot.
        ConfigError: a negative number of steps.

    Example:
        >>> import ikgrad as ik
        >>> from ikgrad.networks import UnrolledInverter
        >>> robot = ik.load_robot("panda")
        >>> found = evaluate(UnrolledInverter(robot), ik.data.TaskStream(robot, batch_size=200), plain_steps=(2,))
        >>> [row.method for row in found.rows][:3]
        ['inverter', 'inverter + 1 step', 'inverter + 2 steps']
    """
    robot = inverter.robot
    assert isinstance(robot, Robot)
    if robot.fingerprint != task.robot.fingerprint:
        raise RobotError(
            f"the inverter is for robot '{robot.name}' ({robot.fingerprint}), the task for '{task.robot.name}' "
            f"({task.robot.fingerprint})"
        )
    if solver_steps < 0 or min(plain_steps, default=0) < 0:
        raise ConfigError(f"numbers of steps must not be negative, got {solver_steps} and {plain_steps}")
    T, _, q_current = task.batch(0)

    def steps(start: Tensor, count: int) -> Tensor:
        return damped_steps(robot, T, start, steps=count).q

    def row(method: str, run: Callable[[], Tensor], extra: float = 0.0) -> Row:
        q, seconds = _timed(run)
        return Row(method, measure(robot, q, T), (seconds / len(T)) * 1e6 + extra)

    with torch.no_grad():
        answers = _call(inverter, T, q_current)
        rows = [row("inverter", lambda: _call(inverter, T, q_current))]
        own = rows[0].microseconds
        for k in range(1, solver_steps + 1):
            rows.append(row(f"inverter + {_steps(k)}", lambda k=k: steps(answers, k), own))  # type: ignore[misc]
        for k in plain_steps:
            rows.append(row(f"plain, {_steps(k)}", lambda k=k: steps(q_current, k)))  # type: ignore[misc]
        k = _as_long(lambda count: steps(q_current, count), own * 1e-6 * len(T))
        rows.append(row(f"plain, as long as the inverter: {_steps(k)}", lambda: steps(q_current, k)))
    return Evaluation(robot.name, robot.fingerprint, task.task, len(T), task.seed, torch.get_num_threads(), tuple(rows))


def _call(inverter: nn.Module, T: Tensor, q_current: Tensor) -> Tensor:
    dtype = getattr(inverter, "dtype", T.dtype)
    given = (T, q_current) if getattr(inverter, "feedback", True) else (T,)
    return inverter(*(tensor.to(dtype) for tensor in given)).double()


def _timed(run: Callable[[], Tensor]) -> tuple[Tensor, float]:
    answer, best = run(), float("inf")
    for _ in range(_REPEATS):
        begun = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - begun)
    return answer, best


def _as_long(run: Callable[[int], Tensor], seconds: float) -> int:
    """The number of steps that takes so long, at least one: from the times of none and of ten."""
    none, ten = (_timed(lambda count=count: run(count))[1] for count in (0, 10))  # type: ignore[misc]
    return max(1, min(_MOST_STEPS, round((seconds - none) / max((ten - none) / 10, 1e-9))))


def _steps(count: int) -> str:
    return "1 step" if count == 1 else f"{count} steps"


def _cells(row: Row) -> tuple[str, ...]:
    e = row.errors
    percentiles = (" / ".join(f"{x:.2g}" for x in values) for values in (e.position_mm, e.rotation_deg))
    shares = (f"{100 * share:.2f} %" for share in (e.inside, e.close, e.exact))
    return row.method, *percentiles, *shares, f"{row.microseconds:.2f}"


__all__ = ["Evaluation", "Row", "evaluate"]
