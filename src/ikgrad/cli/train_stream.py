"""What ``ikgrad train`` shows of inverters that learn from a stream: the live curve, and what the result is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.terminal import Progress, duration, print_table

if TYPE_CHECKING:
    from ikgrad.config import StreamConfig
    from ikgrad.evaluation import Evaluation
    from ikgrad.training.endless import Check
    from ikgrad.training.stream_result import StreamResult
    from ikgrad.training.stream_run import StreamProgress

TEST_SEED = 2**31 - 1  # neither a training nor its curve draws from it


class LiveCurve(Progress):
    """Steps, time left, and the last point of the curve; its units are thousandths of the budget."""

    def __init__(self, config: StreamConfig):
        super().__init__(f"train {Path(config.robot).stem}", 1000, "steps")
        self.now: StreamProgress | None = None
        self._first: StreamProgress | None = None
        self._members = config.members

    def show(self, now: StreamProgress) -> None:
        """Take the state after a step."""
        self._first = self._first or now
        self.now = now
        self.advance(int(1000 * now.share) - self.done)

    @property
    def where(self) -> str:
        """How far it has come, for the line that Ctrl-C prints."""
        return "before the first step" if self.now is None else f"after {self.now.steps:,} steps"

    def state(self) -> str:
        """For a line of text."""
        if self.now is None:
            return "starting"
        return f"{100 * self.now.share:.0f} %, {self.now.steps:,} steps, {self.speed()}"

    def speed(self) -> str:
        """For the end of a bar."""
        now, first = self.now, self._first
        if now is None or first is None or now.seconds <= first.seconds:
            return "starting"
        rate = (now.steps - first.steps) / (now.seconds - first.seconds)
        who = f"member {now.member + 1} of {self._members}, " if self._members > 1 else ""
        return f"{who}{rate:.0f} steps/s, {duration(now.left)} left; median {_error(now.check)}"


def measure(result: StreamResult) -> list[Evaluation]:
    """The best member on fresh rows of the local and the global task, and of its own where that is another one."""
    from ikgrad.data import TaskStream
    from ikgrad.data.stream import LOCAL
    from ikgrad.evaluation import evaluate

    config, inverter = result.config, result.inverter
    tasks = dict.fromkeys((LOCAL, config.spread, None))
    return [
        evaluate(inverter, TaskStream(inverter.robot, batch_size=config.test_rows, spread=spread, seed=TEST_SEED))
        for spread in tasks
    ]


def keep(result: StreamResult, found: Sequence[Evaluation]) -> None:
    """Write what was measured into the run folder."""
    from ikgrad.training.run_folder import RunFolder

    if result.folder is not None:
        RunFolder(result.folder).keep_evaluation([evaluation.record() for evaluation in found])


def show(result: StreamResult, found: Sequence[Evaluation]) -> None:
    """Members, then a table for every task."""
    config = result.config
    shape = ", ".join(f"{key} {value}" for key, value in result.inverter.settings().items())
    columns = ["seed", "steps", "kept", "minutes", "position [mm]", "rotation [deg]"]
    rows = [
        [
            f"{member.seed}",
            f"{member.steps:,}",
            f"{member.best.step:,}",
            f"{member.seconds / 60:.2f}",
            " / ".join(f"{x:.2g}" for x in member.best.position_mm),
            " / ".join(f"{x:.2g}" for x in member.best.rotation_deg),
        ]
        for member in result.members
    ]
    title = (
        f"ikgrad train: {result.inverter.robot.name}, {config.model} ({shape})\n"
        "position, rotation: median / 95 % over the 4,000 rows that decide which weights are kept"
    )
    print_table(title, columns, rows, right=range(len(columns)))
    if len(result.members) > 1:
        print("Below: the member with the smallest loss on these rows.")
    print("Fresh rows; position and rotation: median / 95th / 99.9th percentile.")
    for evaluation in found:
        print("", *evaluation.lines(), sep="\n")
    print(f"\n{duration(result.seconds)}; written to {result.folder}")


def document(result: StreamResult, found: Sequence[Evaluation]) -> dict[str, Any]:
    """The same for programs."""
    return {
        "robot": result.inverter.robot.name,
        "config": vars(result.config),
        "seconds": result.seconds,
        "members": [asdict(member) for member in result.members],
        "evaluation": [evaluation.record() for evaluation in found],
        "out": str(result.folder),
    }


def _error(check: Check) -> str:
    return f"{check.position_mm[0]:.2g} mm, {check.rotation_deg[0]:.2g} deg"
