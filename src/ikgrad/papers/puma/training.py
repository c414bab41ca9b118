"""The networks of the study, trained: all seeds and both data sets of a rule in one stack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ikgrad import optim
from ikgrad.config import RuleConfig, load_config
from ikgrad.errors import TrainingError
from ikgrad.networks import MLP, MinMax
from ikgrad.papers.puma.path import TABLES, PathData, path_data
from ikgrad.papers.puma.printed_results import CASES
from ikgrad.papers.resume import Watch
from ikgrad.resources import builtin_file
from ikgrad.training import Batches, Training, log_epochs


@dataclass(frozen=True)
class CaseResult:
    """A rule on one data set, over all seeds.

    Attributes:
        rule: its settings.
        data: ``"printed"`` or ``"corrected"``.
        epochs: trained.
        rms_deg: (S,) over all 54 angles of each seed.
        joint_rms_deg: (S, 6) over the nine rows of each joint.
        max_deg: (S,) the largest error of each seed.
        errors_deg: (S, 9, 6) answers less desired angles.
        curve_epochs: (E,) of the learning curve.
        curve: (E, S) root of the mean squared error of the scaled outputs.
        diverged_at: (S,) the recorded epoch at which a loss was not finite any more; 0: never.
        seconds: wall time of the whole stack, which may hold other cases too.
        stacked: networks in that stack.
    """

    rule: RuleConfig
    data: str
    epochs: int
    rms_deg: Tensor
    joint_rms_deg: Tensor
    max_deg: Tensor
    errors_deg: Tensor
    curve_epochs: Tensor
    curve: Tensor
    diverged_at: Tensor
    seconds: float
    stacked: int

    @property
    def median_seed(self) -> int:
        """The seed whose rms is in the middle; its table is the one to show."""
        return int(self.rms_deg.argsort()[(len(self.rms_deg) - 1) // 2])


def paper_rules() -> tuple[RuleConfig, ...]:
    """The five rules, from the configuration files.

    Example:
        >>> [rule.name for rule in paper_rules()]
        ['OBP', 'OBPR', 'BBP', 'DBD', 'QP']
    """
    return tuple(load_config(RuleConfig, builtin_file("configs", f"puma_{name.lower()}")) for name in CASES)


def optimizer_for(rule: RuleConfig, network: nn.Module) -> torch.optim.Optimizer:
    """The optimizer that a rule's settings name."""
    if rule.rule == "backprop":
        return optim.Backprop(network.parameters(), rule.lr, momentum=rule.momentum)
    if rule.rule == "delta_bar_delta":
        settings = dict(kappa=rule.kappa, phi=rule.phi, theta=rule.theta, momentum=rule.momentum)
        return optim.DeltaBarDelta(network.parameters(), rule.lr, **settings)
    return optim.Quickprop(network.parameters(), rule.lr, mu=rule.mu, max_step=rule.max_step, literal=rule.literal)


class Stack:
    """Rules that differ by the order of the patterns alone, times data sets, times seeds, as one ensemble.

    Args:
        rules: they share everything but name and order, and all learn per pattern or all per batch.
        seeds: networks of each rule on each data set; seed s starts from the same weights in all of them.
        data: names of the data sets.
    """

    def __init__(self, rules: Sequence[RuleConfig], seeds: int, data: Sequence[str] = tuple(TABLES)):
        self.rules, self.seeds, self.sets = tuple(rules), seeds, [path_data(name) for name in data]
        rule = rules[0]
        self.scales = [_scales(rule, each) for each in self.sets]
        members = len(rules) * len(self.sets) * seeds
        sizes = (3, *rule.hidden, 6)
        self.network = MLP(
            sizes,
            hidden=rule.activation,
            output=rule.output,
            members=members,
            seeds=list(range(seeds)) * (members // seeds),
            bound=rule.bound,
        )
        pairs = zip(self.sets, self.scales, strict=True)
        x, y = zip(*((scale_p(each.p), scale_q(each.q)) for each, (scale_p, scale_q) in pairs), strict=True)
        batches = Batches(
            self._spread(x),
            self._spread(y),
            batch_size=None if rule.order == "batch" else 1,
            shuffle=None if rule.order == "batch" else self._orders(),
        )
        self.training = Training(self.network, optimizer_for(rule, self.network), batches)
        self.seconds = 0.0

    @property
    def name(self) -> str:
        """Such as OBP-OBPR."""
        return "-".join(rule.name for rule in self.rules)

    @property
    def steps(self) -> int:
        """Steps an epoch."""
        return self.training.data.steps

    def _spread(self, each: Sequence[Tensor]) -> Tensor:
        """One tensor a data set -> (members, 9, k), in the order rule, data set, seed."""
        one = torch.stack([item for item in each for _ in range(self.seeds)])
        return one.repeat(len(self.rules), 1, 1)

    def _orders(self) -> list[int]:
        # Seeds of orders must not repeat those of weights; a negative one keeps the order of the table.
        per_rule = {"fixed": [-1] * self.seeds, "random": [10_000 + seed for seed in range(self.seeds)]}
        return [order for rule in self.rules for _ in self.sets for order in per_rule[rule.order]]

    def run(
        self, epochs: int, *, checkpoint: Path | None = None, progress: Callable[[int], None] | None = None
    ) -> None:
        """Train to ``epochs`` in all.

        Args:
            epochs: wanted.
            checkpoint: file that is kept up to date every few seconds and at the end; read first if it exists.
            progress: called with the number of steps done since it was last called; a KeyboardInterrupt that it
                raises stops the training, checkpoint first.

        Raises:
            DataError: the checkpoint is of other settings, or damaged.
        """
        count = None if progress is None else lambda done: progress(done * self.steps)
        with Watch(self.training, self._settings(epochs), checkpoint, count=count) as watch:
            try:
                self.training.run(epochs, record=set(log_epochs(epochs)), after_epoch=watch)
            except TrainingError:  # every network diverged: for eq. (58) as printed that is the result
                self.training.stopped[:] = True
        self.seconds = watch.seconds

    def _settings(self, epochs: int) -> dict[str, Any]:
        rules = [asdict(rule) | {"hidden": list(rule.hidden)} for rule in self.rules]
        return {"rules": rules, "seeds": self.seeds, "data": [each.name for each in self.sets], "epochs": epochs}

    def results(self) -> list[CaseResult]:
        """Every rule on every data set."""
        with torch.no_grad():
            answers = self.network(self.training.data.x)
        return [
            self._result(answers, rule, k * len(self.sets) + j, j)
            for k, rule in enumerate(self.rules)
            for j in range(len(self.sets))
        ]

    def _result(self, answers: Tensor, rule: RuleConfig, place: int, data: int) -> CaseResult:
        rows = slice(place * self.seeds, (place + 1) * self.seeds)
        error = (self.scales[data][1].inverse(answers[rows]) - self.sets[data].q).rad2deg()
        history = self.training.history
        return CaseResult(
            rule,
            self.sets[data].name,
            self.training.epoch,
            rms_deg=error.square().mean((-2, -1)).sqrt(),
            joint_rms_deg=error.square().mean(-2).sqrt(),
            max_deg=error.abs().amax((-2, -1)),
            errors_deg=error,
            curve_epochs=torch.tensor(history.epochs),
            curve=history.train_table()[:, rows].sqrt(),
            diverged_at=self.training.diverged_at[rows].clone(),
            seconds=self.seconds,
            stacked=len(self.training.best_epoch),
        )


def stacks(rules: Sequence[RuleConfig], seeds: int) -> list[Stack]:
    """The rules in as few stacks as possible: those that differ by name and order alone learn side by side."""
    groups: dict[RuleConfig, list[RuleConfig]] = {}
    for rule in rules:
        order = "batch" if rule.order == "batch" else "fixed"
        groups.setdefault(replace(rule, name="", order=order), []).append(rule)  # type: ignore[arg-type]
    return [Stack(group, seeds) for group in groups.values()]


def _scales(rule: RuleConfig, data: PathData) -> tuple[MinMax, MinMax]:
    """Scales of positions and of angles."""
    return (
        MinMax(3, low=rule.low, high=rule.high).fit(data.p),
        MinMax(6, low=rule.low, high=rule.high).fit(data.q),
    )


__all__ = ["CaseResult", "Stack", "optimizer_for", "paper_rules", "stacks"]
