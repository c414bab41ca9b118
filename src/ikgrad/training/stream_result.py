"""What a training on a stream gives back: inverters and their curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ikgrad.config import StreamConfig
from ikgrad.networks import IncrementInverter
from ikgrad.training.endless import Check
from ikgrad.training.events import Point

_COLUMNS = (
    "step,member,seconds,loss,position_median_mm,position_95_mm,rotation_median_deg,rotation_95_deg"  # of history.csv
)


@dataclass(frozen=True)
class StreamMember:
    """How the training of one inverter went.

    Attributes:
        seed: of its first weights and of its samples.
        steps: done.
        seconds: of training.
        best: the point of the curve whose weights are kept.
    """

    seed: int
    steps: int
    seconds: float
    best: Check


@dataclass(frozen=True, eq=False)
class StreamResult:
    """A finished training, one entry a member everywhere.

    Attributes:
        config: the settings.
        inverters: with their best weights, on the CPU.
        members: how it went.
        curves: the points of their curves.
        seconds: of the run, all parts of a resumed one together.
        folder: of the run, if there is one.
    """

    config: StreamConfig
    inverters: tuple[IncrementInverter, ...]
    members: tuple[StreamMember, ...]
    curves: tuple[tuple[Check, ...], ...]
    seconds: float
    folder: Path | None

    @property
    def inverter(self) -> IncrementInverter:
        """The member with the smallest best loss."""
        losses = [member.best.loss for member in self.members]
        return self.inverters[losses.index(min(losses))]


def best_of(curve: Sequence[Check]) -> Check:
    """The point whose weights are kept."""
    return min(curve, key=lambda check: check.loss)


def checks_to_csv(curves: Sequence[Sequence[Check]]) -> str:
    """CSV, one row a point; numbers come back bit for bit."""
    lines = [_COLUMNS]
    for k, curve in enumerate(curves):
        for check in curve:
            numbers = (check.seconds, check.loss, *check.position_mm, *check.rotation_deg)
            lines.append(f"{check.step},{k}," + ",".join(map(repr, numbers)))
    return "\n".join(lines) + "\n"


def checks_from_csv(rows: Sequence[Sequence[str]], members: int) -> list[tuple[Check, ...]]:
    """The inverse, from the rows without their heading."""
    curves: list[list[Check]] = [[] for _ in range(members)]
    for step, member, *rest in rows:
        seconds, loss, *errors = map(float, rest)
        mm, deg = (errors[0], errors[1]), (errors[2], errors[3])
        curves[int(member)].append(Check(int(step), seconds, loss, mm, deg))
    return [tuple(curve) for curve in curves]


def check_points(curve: Sequence[Check], start: int) -> list[Point]:
    """What TensorBoard shall show, from point ``start`` on."""
    return [
        Point(
            check.step,
            {
                "loss/validation": check.loss,
                "position/median_mm": check.position_mm[0],
                "position/95_mm": check.position_mm[1],
                "rotation/median_deg": check.rotation_deg[0],
                "rotation/95_deg": check.rotation_deg[1],
            },
        )
        for check in curve[start:]
    ]


__all__ = ["StreamMember", "StreamResult", "best_of", "check_points", "checks_from_csv", "checks_to_csv"]
