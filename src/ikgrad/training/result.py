"""What a training gives back: inverters, their curves, their test errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ikgrad.config import TrainConfig
from ikgrad.networks import Inverter
from ikgrad.training.events import Point
from ikgrad.training.history import History
from ikgrad.training.measure import TestErrors


class Curve(NamedTuple):
    """Mean squared errors of one network along its training, in the units of the loss.

    Attributes:
        epochs: (E,) at which they were taken.
        train: (E,)
        validation: (E,), or None without validation rows.
    """

    epochs: Tensor
    train: Tensor
    validation: Tensor | None


@dataclass(frozen=True)
class Member:
    """How the training of one network went.

    Attributes:
        seed: of its first weights, its order of the rows, and its samples.
        epochs: done.
        best_epoch: whose weights are kept: of the smallest validation error, or training error without validation rows.
        best_loss: that error, in the units of the loss.
        diverged_at: epoch after which its loss was not finite; 0: it always was.
        test: errors over the test rows; None without any.
    """

    seed: int
    epochs: int
    best_epoch: int
    best_loss: float
    diverged_at: int
    test: TestErrors | None


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A finished training, one entry a member everywhere.

    Attributes:
        config: the settings.
        inverters: with their best weights.
        members: how it went.
        curves: errors along the training.
        seconds: of the training, all parts of a resumed one together.
        folder: of the run, if there is one.
    """

    config: TrainConfig
    inverters: tuple[Inverter, ...]
    members: tuple[Member, ...]
    curves: tuple[Curve, ...]
    seconds: float
    folder: Path | None

    @property
    def inverter(self) -> Inverter:
        """The member with the smallest best loss."""
        losses = [member.best_loss for member in self.members]
        return self.inverters[losses.index(min(losses))]

    @property
    def test_errors(self) -> tuple[TestErrors | None, ...]:
        """Errors over the test rows, None where there are none."""
        return tuple(member.test for member in self.members)


def curves_of(history: History, members: int) -> list[Curve]:
    """One curve for each stacked network."""
    epochs = torch.tensor(history.epochs, dtype=torch.int64)
    train = torch.stack(history.train) if history.train else torch.empty(0, members)
    validation = torch.stack(history.validation) if history.validation else None
    return [Curve(epochs, train[:, k], None if validation is None else validation[:, k]) for k in range(members)]


def curves_to_csv(curves: Sequence[Curve]) -> str:
    """CSV, one row an epoch and member; numbers come back bit for bit."""
    lines = ["epoch,member,train,validation"]
    for k, curve in enumerate(curves):
        validation = [""] * len(curve.epochs) if curve.validation is None else map(repr, curve.validation.tolist())
        rows = zip(curve.epochs.tolist(), curve.train.tolist(), validation, strict=True)
        lines += [f"{epoch},{k},{train!r},{judged}" for epoch, train, judged in rows]
    return "\n".join(lines) + "\n"


def curves_from_csv(rows: Sequence[Sequence[str]], members: int) -> list[Curve]:
    """The inverse, from the rows without their heading."""
    curves = []
    for k in range(members):
        mine = [row for row in rows if row[1] == str(k)]
        train, validation = ([float(row[i]) for row in mine if row[i]] for i in (2, 3))
        epochs = torch.tensor([int(row[0]) for row in mine])
        judged = torch.tensor(validation, dtype=torch.float64) if validation else None
        curves.append(Curve(epochs, torch.tensor(train, dtype=torch.float64), judged))
    return curves


def curve_points(curve: Curve, start: int) -> list[Point]:
    """What TensorBoard shall show, from point ``start`` on."""
    points = []
    for i in range(start, len(curve.epochs)):
        values = {"loss/train": curve.train[i].item()}
        if curve.validation is not None:
            values["loss/validation"] = curve.validation[i].item()
        points.append(Point(int(curve.epochs[i]), values))
    return points


def member_from_json(values: dict[str, Any]) -> Member:
    """The inverse of ``dataclasses.asdict`` after a round trip through JSON."""
    test = values.pop("test")
    if test is not None:
        spreads = {key: tuple(test[key]) for key in ("position_mm", "rotation_deg")}
        test = TestErrors(**{**test, **spreads})
    return Member(**values, test=test)


def member_to_json(member: Member) -> dict[str, Any]:
    """Plain values; JSON knows no infinity."""
    values = asdict(member)
    if not abs(member.best_loss) < float("inf"):
        values["best_loss"] = None
    return values


__all__ = [
    "Curve",
    "Member",
    "TrainResult",
    "curve_points",
    "curves_from_csv",
    "curves_of",
    "curves_to_csv",
    "member_from_json",
    "member_to_json",
]
