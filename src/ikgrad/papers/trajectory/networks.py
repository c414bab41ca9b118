"""The networks of the paper: three places of the arm from the time and angles, by two rules, over seeds."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from ikgrad import optim
from ikgrad.config import TrajectoryConfig
from ikgrad.networks import MLP
from ikgrad.papers.trajectory.patterns import TARGETS, TRAIN_INSTANTS, along, random_destinations, unseen
from ikgrad.training import Batches, Training

Rule = Literal["per-pattern", "Levenberg-Marquardt"]
RULES: tuple[Rule, ...] = ("per-pattern", "Levenberg-Marquardt")
LM_EPOCH = 30  # epochs per pattern that take as long as one of Levenberg-Marquardt, for progress
Counter = Callable[[int], object]


class Scale(NamedTuple):
    """Columns of S data sets to ranges of choice, each set by its own smallest and largest values."""

    start: Tensor  # (S, 1, k)
    factor: Tensor  # (S, 1, k)
    low: Tensor  # (k,)

    def __call__(self, x: Tensor) -> Tensor:
        """(..., N, k) in scaled units, (S, N, k)."""
        return self.low + (x - self.start) * self.factor

    def inverse(self, s: Tensor) -> Tensor:
        """(S, N, k) back in units of its own."""
        return self.start + (s - self.low) / self.factor


def fit(x: Tensor, low: Tensor, high: Tensor, *, margin: float = 0.0) -> Scale:
    """The scale that puts x (S, N, k), ``margin`` beyond its extremes included, between ``low`` and ``high`` (k,)."""
    least, most = x.amin(-2, keepdim=True) - margin, x.amax(-2, keepdim=True) + margin
    return Scale(least, (high - low) / (most - least), low)


@dataclass(frozen=True)
class NetworkResult:
    """S networks for one place of the arm, judged along both unseen destinations.

    Attributes:
        target: which place, see `TARGETS`.
        rule: how they were trained.
        hidden: units of the hidden layer.
        epochs: of the training.
        patterns: in each training set.
        seconds: of the training of all S side by side.
        train_max: (S,) largest error of a coordinate on the training set [unit].
        answers: (S, 2, T, 3) positions along both destinations.
        truth: (2, T, 3) by polynomials and forward kinematics.
    """

    target: str
    rule: Rule
    hidden: int
    epochs: int
    patterns: int
    seconds: float
    train_max: Tensor
    answers: Tensor
    truth: Tensor

    @property
    def errors(self) -> Tensor:
        """(S, 2, T, 3) answers less the truth [unit]."""
        return self.answers - self.truth

    @property
    def worst(self) -> Tensor:
        """(S, 2) largest error of a coordinate along each destination [unit]."""
        return self.errors.abs().amax((-2, -1))

    @property
    def rms(self) -> Tensor:
        """(S,) root of the mean squared error of a coordinate over both [unit]."""
        return self.errors.square().mean((-3, -2, -1)).sqrt()

    @property
    def median_seed(self) -> int:
        """The seed whose largest error is in the middle; its path is the one to show."""
        return int(self.worst.amax(-1).argsort()[(len(self.worst) - 1) // 2])


class Ensemble:
    """S networks for one place of the arm, each with destinations, first weights and an order of patterns of its own.

    Per pattern the network is the paper's: logistic units in the hidden and the last layer, a step after every
    pattern, no momentum, thresholds trained, here in a new random order every epoch and with a tenth of the rate for
    the last fifth. Levenberg-Marquardt trains tanh units and a linear last layer on the whole set.
    """

    def __init__(self, target: str, rule: Rule, config: TrajectoryConfig):
        self.target, self.rule, self.config = target, rule, config
        seeds = range(config.seeds)
        sets = torch.stack([random_destinations(config.destinations, seed=seed) for seed in seeds])
        x, y = (each.flatten(-3, -2) for each in along(sets, target, config.tf, TRAIN_INSTANTS))
        online = rule == "per-pattern"
        reach = torch.ones(x.shape[-1], dtype=torch.float64)
        reach[0] = config.time_range  # the angles of all inputs change little; the time sees many bends
        self.inputs = fit(x, -reach, reach)
        one = torch.ones(3, dtype=torch.float64)
        self.outputs = fit(y, 0.0 * one if online else -one, one, margin=config.margin if online else 0.0)
        hidden = config.hidden if target == "hand" else config.joint_hidden
        self.network = MLP(
            (x.shape[-1], hidden, 3),
            hidden="logistic" if online else "tanh",
            output="logistic" if online else "linear",
            members=config.seeds,
            seeds=seeds,
        )
        # Seeds of orders must not repeat those of weights.
        shuffle = [10_000 + seed for seed in seeds] if online else None
        batches = Batches(self.inputs(x), self.outputs(y), batch_size=1 if online else None, shuffle=shuffle)
        self.training = Training(self.network, self._optimizer(), batches)
        self.y = y

    def run(self, *, count: Counter | None = None) -> NetworkResult:
        """Train and judge.

        Args:
            count: called with the work done since it was last called, in epochs per pattern.
        """
        start = time.perf_counter()
        watch = None if count is None else _Watch(count, 1 if self.rule == "per-pattern" else LM_EPOCH)
        last = epochs(self.target, self.rule, self.config)
        if self.rule == "per-pattern":
            self.training.run(last - last // 5, record=(), after_epoch=watch)
            self.training.optimizer.param_groups[0]["lr"] /= 10.0
        self.training.run(last, record=(), after_epoch=watch)
        return self._judge(time.perf_counter() - start)

    def answers(self, x: Tensor) -> Tensor:
        """(S, ..., 3) positions for inputs (..., k) as `along` has them."""
        with torch.no_grad():
            flat = self.outputs.inverse(self.network(self.inputs(x.reshape(-1, x.shape[-1]))))
        return flat.reshape(self.config.seeds, *x.shape[:-1], 3)

    def train_rms(self) -> Tensor:
        """(S,) root of the mean squared error of a coordinate on the training set [unit]."""
        return self._train_errors().square().mean((-2, -1)).sqrt()

    def _train_errors(self) -> Tensor:
        with torch.no_grad():
            return self.outputs.inverse(self.network(self.training.data.x)) - self.y

    def _optimizer(self) -> torch.optim.Optimizer:
        parameters = self.network.parameters()
        if self.rule == "per-pattern":
            return optim.Backprop(parameters, self.config.lr)
        return optim.LevenbergMarquardt(parameters, members=self.config.seeds)

    def _judge(self, seconds: float) -> NetworkResult:
        x, truth = unseen(self.target, self.config.tf)
        return NetworkResult(
            self.target,
            self.rule,
            self.network.sizes[1],
            self.training.epoch,
            self.y.shape[-2],
            seconds,
            train_max=self._train_errors().abs().amax((-2, -1)),
            answers=self.answers(x),
            truth=truth,
        )


class _Watch:
    """Told after epochs: how many were done since it was last told."""

    def __init__(self, count: Counter, weight: int):
        self.count, self.weight, self.epoch = count, weight, 0

    def __call__(self, training: Training) -> None:
        done, self.epoch = training.epoch - self.epoch, training.epoch
        self.count(self.weight * done)


def epochs(target: str, rule: Rule, config: TrajectoryConfig) -> int:
    """Of a training."""
    if rule == "per-pattern":
        return config.epochs if target == "hand" else config.joint_epochs
    return config.lm_epochs if target == "hand" else config.joint_lm_epochs


def work(config: TrajectoryConfig) -> int:
    """All that `Ensemble.run` counts for all places and both rules."""
    return sum(
        epochs(target, rule, config) * (1 if rule == "per-pattern" else LM_EPOCH)
        for rule in RULES
        for target in TARGETS
    )


__all__ = ["RULES", "Ensemble", "NetworkResult", "Rule", "Scale", "epochs", "fit", "work"]
