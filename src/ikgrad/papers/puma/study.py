"""The whole study as one record: `run_study` computes it, `PumaStudy.to_json` hands it to a program."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from ikgrad import __version__
from ikgrad.config import PumaConfig, RuleConfig
from ikgrad.papers.puma.beyond import Race, run_races
from ikgrad.papers.puma.checks import check
from ikgrad.papers.puma.errata import errata
from ikgrad.papers.puma.path import PathRow, check_path
from ikgrad.papers.puma.printed_results import PrintedCase, printed_cases
from ikgrad.papers.puma.training import CaseResult, Stack, paper_rules, stacks
from ikgrad.papers.record import Check, Erratum, one_thread, plain

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class PumaStudy:
    """Everything that ``ikgrad reproduce puma`` shows.

    Attributes:
        config: the settings, rules included.
        versions: of the packages that the numbers depend on.
        path: Table 1 against forward kinematics, row by row.
        printed: Tables 2 to 6 and 8, errors recomputed.
        cases: every rule on both data sets, over all seeds.
        literal: eq. (58) as printed, on the printed data.
        races: the rules against others on three problems; empty unless asked for.
        errata: the misprints that this run can show.
        checks: what is claimed, and whether it holds here.
    """

    config: PumaConfig
    versions: dict[str, str]
    path: tuple[PathRow, ...]
    printed: tuple[PrintedCase, ...]
    cases: tuple[CaseResult, ...]
    literal: CaseResult
    races: tuple[Race, ...]
    errata: tuple[Erratum, ...]
    checks: tuple[Check, ...]

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain dictionaries and lists."""
        return {
            "paper": "puma",
            "config": plain(asdict(self.config)),
            "versions": self.versions,
            "table1": [plain(asdict(row)) for row in self.path],
            "printed": [_numbers(case) for case in self.printed],
            "cases": [_numbers(case) for case in self.cases],
            "literal_eq58": _numbers(self.literal),
            "races": [plain(asdict(race)) for race in self.races],
            "errata": [asdict(erratum) for erratum in self.errata],
            "checks": [asdict(check) for check in self.checks],
        }


def run_study(
    config: PumaConfig | None = None,
    *,
    races: bool = False,
    checkpoints: Path | None = None,
    progress: Progress | None = None,
) -> PumaStudy:
    """Train all cases and compare them with the paper.

    Args:
        config: settings; default: `PumaConfig`, the five rules, 16 seeds, 111,111 epochs.
        races: also run the rules against others on three problems.
        checkpoints: folder of checkpoints; what is found there is gone on with.
        progress: called as ``progress(label, done, total)`` in steps of training.

    Raises:
        DataError: a checkpoint is of other settings, or damaged.

    Example:
        >>> study = run_study(PumaConfig(epochs=20, seeds=2, literal_epochs=20))
        >>> [case.rule.name for case in study.cases if case.data == "printed"]
        ['OBP', 'OBPR', 'BBP', 'DBD', 'QP']
    """
    config = config or PumaConfig()
    config = replace(config, rules=config.rules or paper_rules())
    cases, literal = _train(config, checkpoints, progress)
    with one_thread():
        raced = run_races(progress) if races else ()
    path, printed = check_path(), printed_cases()
    order = [(rule.name, data) for data in ("printed", "corrected") for rule in config.rules]
    cases = sorted(cases, key=lambda case: order.index((case.rule.name, case.data)))
    return PumaStudy(
        config,
        {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
        path,
        printed,
        tuple(cases),
        literal,
        tuple(raced),
        errata=errata(path, printed, literal),
        checks=check(path, printed, cases, literal),
    )


def _train(
    config: PumaConfig, checkpoints: Path | None, progress: Progress | None
) -> tuple[list[CaseResult], CaseResult]:
    jobs = [(stack, config.epochs) for stack in stacks(config.rules, config.seeds)]
    printed_rule = RuleConfig(name="QP as printed", rule="quickprop", order="batch", literal=True)
    jobs.append((Stack([printed_rule], config.seeds, data=["printed"]), config.literal_epochs))
    counter = _Counter(progress, total=sum(stack.steps * epochs for stack, epochs in jobs))
    results: list[CaseResult] = []
    for stack, epochs in jobs:
        counter.label = f"puma: {stack.name}"
        file = checkpoints / f"{stack.name.replace(' ', '_')}.ckpt" if checkpoints is not None else None
        stack.run(epochs, checkpoint=file, progress=counter)
        results += stack.results()
    return results[:-1], results[-1]


class _Counter:
    """Adds up the steps of one stack after another."""

    def __init__(self, progress: Progress | None, *, total: int):
        self.progress, self.total = progress, total
        self.done = 0
        self.label = ""

    def __call__(self, steps: int) -> None:
        self.done += steps
        if self.progress is not None:
            self.progress(self.label, self.done, self.total)


def _numbers(record: Any) -> dict[str, Any]:
    """A record of numbers and tensors as plain values; curves are left out."""
    values = {key: value for key, value in vars(record).items() if not key.startswith("curve")}
    values = {key: value.tolist() if isinstance(value, torch.Tensor) else value for key, value in values.items()}
    return plain({key: asdict(value) if isinstance(value, RuleConfig) else value for key, value in values.items()})


__all__ = ["PumaStudy", "run_study"]
