"""The whole study as one record: `run_study` computes it, `TrajectoryStudy.to_json` hands it to a program."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import torch

from ikgrad import __version__
from ikgrad.config import TrajectoryConfig
from ikgrad.papers.record import Check, Erratum, one_thread, plain
from ikgrad.papers.trajectory.arm import REACH, PointRow, check_points
from ikgrad.papers.trajectory.checks import check
from ikgrad.papers.trajectory.curves import CurveRow, check_curves, scipy_difference
from ikgrad.papers.trajectory.errata import errata
from ikgrad.papers.trajectory.networks import RULES, Ensemble, NetworkResult, Rule, work
from ikgrad.papers.trajectory.obstacle import (
    CENTER,
    RADIUS,
    LinkResult,
    RandomRow,
    VerdictRow,
    predicted_links,
    random_spheres,
    verdicts,
)
from ikgrad.papers.trajectory.patterns import TARGETS
from ikgrad.papers.trajectory.spheres import SphereTest, sphere_test

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TrajectoryStudy:
    """Everything that ``ikgrad reproduce trajectory`` shows.

    Attributes:
        config: the settings.
        versions: of the packages that the numbers depend on.
        seconds: of the whole run.
        points: Table 1's points against forward kinematics.
        curves: the 4-3-4 curves.
        scipy: largest difference from scipy's splines; None where scipy is not installed.
        networks: rule to place to its networks.
        links: rule to predicted links.
        verdicts: the obstacle, by rule and destination.
        random: random spheres, by rule.
        spheres: the sphere test on random segments.
        errata: the misprints.
        checks: what is claimed, and whether it holds here.
    """

    config: TrajectoryConfig
    versions: dict[str, str]
    seconds: float
    points: tuple[PointRow, ...]
    curves: tuple[CurveRow, ...]
    scipy: float | None
    networks: dict[Rule, dict[str, NetworkResult]]
    links: dict[Rule, LinkResult]
    verdicts: tuple[VerdictRow, ...]
    random: tuple[RandomRow, ...]
    spheres: SphereTest
    errata: tuple[Erratum, ...]
    checks: tuple[Check, ...]

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain dictionaries and lists; of the paths, that of the median seed to each destination."""
        return {
            "paper": "trajectory",
            "config": asdict(self.config),
            "versions": self.versions,
            "seconds": self.seconds,
            "points": [plain(asdict(row)) for row in self.points],
            "curves": [plain(asdict(row)) for row in self.curves],
            "scipy_difference": self.scipy,
            "networks": [_numbers(r) for results in self.networks.values() for r in results.values()],
            "links": [
                {"rule": rule, "worst_unit": links.worst.tolist(), "length_range": _range(links)}
                for rule, links in self.links.items()
            ],
            "obstacle": {"center": list(CENTER), "radius": RADIUS},
            "verdicts": [_verdict(row) for row in self.verdicts],
            "random_spheres": [asdict(row) for row in self.random],
            "sphere_test": asdict(self.spheres),
            "errata": [asdict(erratum) for erratum in self.errata],
            "checks": [asdict(check) for check in self.checks],
        }


def run_study(config: TrajectoryConfig | None = None, *, progress: Progress | None = None) -> TrajectoryStudy:
    """Train all networks, under two minutes on one core, and compare them with the paper.

    Args:
        config: settings; default: `TrajectoryConfig`.
        progress: called as ``progress(label, done, total)`` after epochs, in those of the per-pattern rule.

    Example:
        >>> quick = TrajectoryConfig(seeds=2, epochs=5, joint_epochs=5, lm_epochs=2, joint_lm_epochs=2, segments=100)
        >>> study = run_study(quick)
        >>> len(study.errata), study.spheres.wrong
        (11, 0)
    """
    config = config or TrajectoryConfig()
    counter = _Counter(progress, total=work(config))
    start = time.perf_counter()
    with one_thread():
        networks = {rule: _train(rule, config, counter) for rule in RULES}
        links = {rule: predicted_links(results) for rule, results in networks.items()}
        rows = tuple(row for each in links.values() for row in verdicts(each, config.tf))
        random = tuple(random_spheres(each) for each in links.values())
        spheres = sphere_test(config.segments)
        misprints = errata(spheres, config)
    points, curves, scipy = check_points(), check_curves(config.tf), scipy_difference(config.tf)
    hands = {rule: results["hand"] for rule, results in networks.items()}
    return TrajectoryStudy(
        config,
        {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
        time.perf_counter() - start,
        points,
        curves,
        scipy,
        networks,
        links,
        rows,
        random,
        spheres,
        misprints,
        checks=check(points, curves, scipy, hands, rows, random, spheres),
    )


def _train(rule: Rule, config: TrajectoryConfig, counter: _Counter) -> dict[str, NetworkResult]:
    return {target: Ensemble(target, rule, config).run(count=counter.of(f"{target}, {rule}")) for target in TARGETS}


class _Counter:
    """Adds up the work of one part after another."""

    def __init__(self, progress: Progress | None, *, total: int):
        self.progress, self.total, self.done = progress, total, 0

    def of(self, part: str) -> Callable[[int], None]:
        """What a part calls with the work that it has done."""

        def count(work: int) -> None:
            self.done += work
            if self.progress is not None:
                self.progress(f"trajectory: {part}", self.done, self.total)

        return count


def _numbers(result: NetworkResult) -> dict[str, Any]:
    seed = result.median_seed
    return {
        "target": result.target,
        "rule": result.rule,
        "hidden": result.hidden,
        "epochs": result.epochs,
        "patterns": result.patterns,
        "seconds": result.seconds,
        "worst_unit": result.worst.tolist(),
        "worst_percent_of_reach": (100 * result.worst / REACH).tolist(),
        "rms_unit": result.rms.tolist(),
        "train_max_unit": result.train_max.tolist(),
        "median_seed": seed,
        "truth": result.truth.tolist(),
        "answers": result.answers[seed].tolist(),
    }


def _range(links: LinkResult) -> list[float]:
    return [links.lengths.min().item(), links.lengths.max().item()]


def _verdict(row: VerdictRow) -> dict[str, Any]:
    """JSON has no infinity: a motion that is free has no contact."""
    return asdict(row) | {"contact": row.contact if row.proof != "free" else None}


__all__ = ["TrajectoryStudy", "run_study"]
