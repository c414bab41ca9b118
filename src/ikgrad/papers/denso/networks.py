"""The two networks of the paper on a sampling scheme, over seeds: mean squared errors, R, positions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ikgrad.data import DataSet, Samples, Scheme, generate
from ikgrad.kinematics import forward_kinematics
from ikgrad.networks import Inverter
from ikgrad.papers.denso.arm import denso
from ikgrad.papers.resume import Watch
from ikgrad.training.inverters import InverterTraining, answers

NAMES = ("traditional", "feedback")  # the paper calls the second one "proposed"
Counter = Callable[[int], object]


@dataclass(frozen=True)
class NetworkResult:
    """One kind of network on S data sets, judged on their test rows, present joints given.

    Attributes:
        name: ``"traditional"`` or ``"feedback"``.
        epochs: of the training.
        seconds: of the training of all S side by side.
        mse: (S,) mean squared error of the joints [rad^2].
        regression: (S,) correlation of answers and targets, see `regression`.
        position_mm: (S, 3) largest error of x, y and z [mm].
        curve_train: (epochs, S) mean squared error along the training [rad^2].
        curve_validation: (epochs, S) the same on the validation rows.
        median_seed: by the mean squared error.
        targets: (N, n) joints of the test rows of that seed [rad].
        answers: (N, n) its answers [rad].
    """

    name: str
    epochs: int
    seconds: float
    mse: Tensor
    regression: Tensor
    position_mm: Tensor
    curve_train: Tensor
    curve_validation: Tensor
    median_seed: int
    targets: Tensor
    answers: Tensor


def train(
    name: str,
    data: Sequence[DataSet],
    epochs: int,
    *,
    seeds: Sequence[int],
    best: bool = True,
    count: Counter | None = None,
    checkpoint: Path | None = None,
) -> tuple[NetworkResult, list[Inverter]]:
    """Train one network a data set by Levenberg-Marquardt, ten tanh units, as the paper has it.

    Args:
        name: ``"traditional"`` or ``"feedback"``.
        data: the data sets.
        epochs: how long; no network stops earlier.
        seeds: of the first weights.
        best: keep the weights with the smallest validation error, instead of the last.
        count: called with the number of networks after every epoch.
        checkpoint: file that is kept up to date every few seconds and at the end; read first if it exists.

    Raises:
        DataError: the checkpoint is of other settings, or damaged.
    """
    inverters = [Inverter(denso(), feedback=name == "feedback", seed=seed) for seed in seeds]
    training = InverterTraining(inverters, data)
    settings = {"network": name, "epochs": epochs, "seeds": list(seeds), "best": best, "data": data_digest(data)}
    each = None if count is None else lambda done: count(done * len(data))
    with Watch(training.training, settings, checkpoint, count=each) as watch:
        training.run(epochs, after_epoch=watch)
    training.finish(best=best)
    rows = [(answers(inverter, d.test), d.test) for inverter, d in zip(inverters, data, strict=True)]
    history = training.training.history
    mse = training.test_errors()
    middle = int(mse.argsort()[(len(mse) - 1) // 2])
    result = NetworkResult(
        name,
        epochs,
        watch.seconds,
        mse,
        torch.stack([regression(q, test.q) for q, test in rows]),
        torch.stack([axis_errors_mm(q, test).abs().amax(0) for q, test in rows]),
        history.train_table(),
        history.validation_table(),
        middle,
        rows[middle][1].q,
        rows[middle][0],
    )
    return result, inverters


def data_digest(data: Sequence[DataSet]) -> str:
    """What the rows are, short enough for a message."""
    recipes: list[dict[str, Any]] = [each.recipe for each in data]
    return hashlib.sha256(json.dumps(recipes, sort_keys=True).encode()).hexdigest()[:12]


def checkpoint_file(folder: Path | None, part: str, name: str) -> Path | None:
    """Where one training of a part of the study keeps its checkpoint; nowhere without a folder."""
    return None if folder is None else folder / f"{part}_{name}.ckpt"


def make_data(schemes: Sequence[Scheme]) -> list[DataSet]:
    """Data sets of the arm."""
    return [generate(denso(), scheme) for scheme in schemes]


def regression(q: Tensor, target: Tensor) -> Tensor:
    """Correlation R of answers and targets over all rows and joints, each joint less its own mean.

    With the means left in, R would say that the joints differ from each other, and be 0.99999 for any network.

    Args:
        q: (N, n) answers.
        target: (N, n) targets.
    """
    a, b = ((x - x.mean(0)).flatten() for x in (q, target))
    return (a @ b) / (a.norm() * b.norm())


def median(values: Tensor) -> Tensor:
    """Over the seeds, the first dimension; of an even number the mean of the two in the middle."""
    return values.quantile(0.5, dim=0)


def axis_errors_mm(q: Tensor, rows: Samples) -> Tensor:
    """(N, 3) position that the joints give, less the wanted one [mm]."""
    return 1000.0 * (forward_kinematics(denso(), q)[..., :3, 3] - rows.T[..., :3, 3])


def copy_error(data: DataSet) -> float:
    """Mean squared error of answering with the present joints [rad^2]: what a network that learns nothing reaches."""
    return (data.test.q_current - data.test.q).square().mean().item()


__all__ = [
    "NAMES",
    "NetworkResult",
    "axis_errors_mm",
    "checkpoint_file",
    "copy_error",
    "data_digest",
    "make_data",
    "median",
    "regression",
    "train",
]
