"""An inverter on a task, before and after solver steps, beside plain damped steps that take as long."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

from ikgrad.data import TaskStream
from ikgrad.errors import ConfigError, RobotError
from ikgrad.evaluation.errors import measure
from ikgrad.evaluation.records import PLAIN_STEPS, Answers, Evaluation, Protocol, Row
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps

_REPEATS = 5  # timings; the shortest counts
_MOST_STEPS = 200  # of the baseline that takes as long as the inverter


def evaluate(
    inverter: nn.Module,
    task: TaskStream | Protocol,
    *,
    solver_steps: int = 3,
    plain_steps: tuple[int, ...] = PLAIN_STEPS,
) -> Evaluation:
    """Measure an inverter on batch 0 of a task or by a protocol, and what plain damped steps do with the same rows.

    Args:
        inverter: with a ``robot``; called with poses and present joints, or with poses alone if its ``feedback`` is
            False.
        task: rows to answer; take a seed that it was not trained with. Or a protocol, see
            `ikgrad.evaluation.protocols`.
        solver_steps: also after 1 to so many damped steps from its answers.
        plain_steps: numbers of plain damped steps from the present joints. One more row takes as many steps as fit
            into the time of the inverter.

    Returns:
        Errors and times, in the order: inverter, after each solver step, plain steps.

    Raises:
        RobotError: the task is for another robot, or the protocol cannot be asked of this one.
        ConfigError: a negative number of steps.

    Example:
        >>> import ikgrad as ik
        >>> from ikgrad.networks import UnrolledInverter
        >>> robot = ik.load_robot("panda")
        >>> found = evaluate(UnrolledInverter(robot), ik.data.TaskStream(robot, batch_size=200), plain_steps=(2,))
        >>> [row.method for row in found.rows][:3]
        ['inverter', 'inverter + 1 step', 'inverter + 2 steps']
    """
    if isinstance(task, Protocol):
        return task.run(inverter, solver_steps=solver_steps, plain_steps=plain_steps)
    robot = robot_of(inverter)
    if robot.fingerprint != task.robot.fingerprint:
        raise RobotError(
            f"the inverter is for robot '{robot.name}' ({robot.fingerprint}), the task for '{task.robot.name}' "
            f"({task.robot.fingerprint})"
        )
    T, _, q_current = task.batch(0)
    rows, answers = side_by_side(inverter, T, q_current, solver_steps=solver_steps, plain_steps=plain_steps)
    threads = torch.get_num_threads()
    return Evaluation(robot.name, robot.fingerprint, task.task, len(T), task.seed, threads, rows, answers=answers)


def side_by_side(
    inverter: nn.Module, T: Tensor, q_current: Tensor, *, solver_steps: int, plain_steps: tuple[int, ...]
) -> tuple[tuple[Row, ...], Answers]:
    """The rows of `evaluate`, and the inverter's answers.

    Args:
        inverter: as in `evaluate`.
        T: (N, 4, 4) poses, float64.
        q_current: (N, n) present joints, float64.
        solver_steps: as in `evaluate`.
        plain_steps: as in `evaluate`.
    """
    check_steps(solver_steps, plain_steps)
    robot = robot_of(inverter)

    def steps(start: Tensor, count: int) -> Tensor:
        return damped_steps(robot, T, start, steps=count).q

    def row(method: str, run: Callable[[], Tensor], extra: float = 0.0) -> Row:
        q, seconds = timed(run)
        return Row(method, measure(robot, q, T), (seconds / len(T)) * 1e6 + extra)

    with torch.no_grad():
        answers = call(inverter, T, q_current)
        rows = [row("inverter", lambda: call(inverter, T, q_current))]
        own = rows[0].microseconds
        for k in range(1, solver_steps + 1):
            rows.append(row(f"inverter + {in_words(k)}", lambda k=k: steps(answers, k), own))  # type: ignore[misc]
        for k in plain_steps:
            rows.append(row(f"plain, {in_words(k)}", lambda k=k: steps(q_current, k)))  # type: ignore[misc]
        k = _as_long(lambda count: steps(q_current, count), own * 1e-6 * len(T))
        rows.append(row(f"plain, in the same time: {in_words(k)}", lambda: steps(q_current, k)))
    return tuple(rows), Answers(answers, T)


def call(inverter: nn.Module, T: Tensor, q_current: Tensor) -> Tensor:
    """(N, n) answers in float64, of whatever kind of inverter."""
    dtype = getattr(inverter, "dtype", T.dtype)
    given = (T, q_current) if takes_joints(inverter) else (T,)
    return inverter(*(tensor.to(dtype) for tensor in given)).double()


def takes_joints(inverter: nn.Module) -> bool:
    """Whether it looks at the present joints."""
    return bool(getattr(inverter, "feedback", True))


def robot_of(inverter: nn.Module) -> Robot:
    """The robot that an inverter serves."""
    robot = inverter.robot
    assert isinstance(robot, Robot)
    return robot


def check_steps(solver_steps: int, plain_steps: tuple[int, ...]) -> None:
    """Refuse negative numbers of steps."""
    if solver_steps < 0 or min(plain_steps, default=0) < 0:
        raise ConfigError(f"numbers of steps must not be negative, got {solver_steps} and {plain_steps}")


def timed(run: Callable[[], Tensor], *, repeats: int = _REPEATS) -> tuple[Tensor, float]:
    """An answer, and the shortest time that it took, the first time aside [s]."""
    answer, best = run(), float("inf")
    for _ in range(repeats):
        begun = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - begun)
    return answer, best


def in_words(steps: int) -> str:
    """How many steps."""
    return "1 step" if steps == 1 else f"{steps} steps"


def _as_long(run: Callable[[int], Tensor], seconds: float) -> int:
    """The number of steps that takes so long, at least one: from the times of none and of ten."""
    none, ten = (timed(lambda count=count: run(count))[1] for count in (0, 10))  # type: ignore[misc]
    return max(1, min(_MOST_STEPS, round((seconds - none) / max((ten - none) / 10, 1e-9))))


__all__ = ["evaluate"]
