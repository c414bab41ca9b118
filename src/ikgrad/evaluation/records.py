"""What an evaluation returns: methods side by side on the same rows, as plain records and as a table."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from torch import Tensor, nn

from ikgrad.errors import ConfigError
from ikgrad.evaluation.errors import Errors

PLAIN_STEPS = (1, 2, 3, 4, 6, 8)
_LAST_SEED = 2**31 - 1


@dataclass(frozen=True)
class Row:
    """One method on one task.

    Attributes:
        method: in words.
        errors: of its answers.
        microseconds: a pose, all poses at once (paths: all paths at once, point by point); the shortest of some runs.
        extra: what its protocol measures besides.
    """

    method: str
    errors: Errors
    microseconds: float
    extra: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Answers:
    """Rows of one method, kept for pictures.

    Attributes:
        q: (N, n) answers [rad or m].
        T_target: (N, 4, 4) wanted poses [m].
    """

    q: Tensor
    T_target: Tensor


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
        rows: the inverter, the inverter and solver steps, then what stands beside it.
        protocol: its name; empty for a task of one's own.
        notes: what a reader of the table has to know.
        published: numbers of others, quoted and not measured; with their source.
        answers: the inverter's, as they come out of it; not part of the record.
    """

    robot: str
    fingerprint: str
    task: str
    count: int
    seed: int
    threads: int
    rows: tuple[Row, ...]
    protocol: str = ""
    notes: tuple[str, ...] = ()
    published: Mapping[str, Any] = field(default_factory=dict)
    answers: Answers | None = field(default=None, repr=False, compare=False)

    def record(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        parts = {name: value for name, value in vars(self).items() if name not in ("answers", "rows")}
        return {**parts, "notes": list(self.notes), "rows": [asdict(row) for row in self.rows]}

    @property
    def title(self) -> str:
        """What was asked, in one line."""
        threads = "1 thread" if self.threads == 1 else f"{self.threads} threads"
        return f"{self.robot}, task {self.task}, {self.count:,} poses, seed {self.seed}, {threads}"

    def lines(self) -> list[str]:
        """A Markdown table, line by line: percentiles are median / 95th / 99.9th."""
        from ikgrad.evaluation.table import cells

        head, *body = cells(self)
        table = [head, ["---"] * len(head), *body]
        return [self.title, "", *("| " + " | ".join(row) + " |" for row in table)]


@dataclass(frozen=True)
class Protocol(ABC):
    """A question that others ask as well.

    Attributes:
        count: poses; 0: as many as the protocol says.
        seed: of all draws. Rows of the trainings in this package with an ordinary seed are never among them.

    Raises:
        ConfigError: a setting is out of range.
    """

    count: int = 0
    seed: int = 0

    name: ClassVar[str]
    poses: ClassVar[int]  # unless ``count`` says otherwise

    def __post_init__(self) -> None:
        if self.count < 0:
            raise ConfigError(f"count must be at least 1, or 0 for the protocol's own, got {self.count}")
        if not 0 <= self.seed <= _LAST_SEED:
            raise ConfigError(f"seed must be in [0, 2^31), got {self.seed}")

    @abstractmethod
    def run(
        self, inverter: nn.Module, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = PLAIN_STEPS
    ) -> Evaluation:
        """Ask an inverter.

        Args:
            inverter: with a ``robot``; called with poses and present joints, or with poses alone if its ``feedback``
                is False.
            solver_steps: also after 1 to so many damped steps from its answers.
            plain_steps: numbers of plain damped steps that stand beside it.

        Raises:
            RobotError: the protocol cannot be asked of this robot.
            ConfigError: a negative number of steps.
        """

    @property
    def _number(self) -> int:
        return self.count or self.poses

    @property
    def _row_seed(self) -> int:
        """Counted down from the end, where no training draws from."""
        return _LAST_SEED - self.seed


__all__ = ["PLAIN_STEPS", "Answers", "Evaluation", "Protocol", "Row"]
