"""The whole study as one record: `run_study` computes it, `AppsStudy.to_json` hands it to a program."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ikgrad import __version__
from ikgrad.config import AppsConfig
from ikgrad.papers.apps import compare
from ikgrad.papers.apps.checks import check
from ikgrad.papers.apps.compare import DescentRow, NewtonRow, RandomRow
from ikgrad.papers.apps.errata import errata
from ikgrad.papers.apps.experiment import Motion, solve_motions
from ikgrad.papers.apps.tables import Tables, all_tables
from ikgrad.papers.record import Check, Erratum, one_thread, plain
from ikgrad.solvers.apps import Apps

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class AppsStudy:
    """Everything that ``ikgrad reproduce apps`` shows.

    Attributes:
        config: the settings.
        versions: of the packages that the numbers depend on.
        motions: the seven motions with their paths.
        tables: Tables 3 to 6, ours beside the paper's.
        newton: Newton-Raphson from the same starts.
        newton_tool_frame: its inconsistent variant.
        printed_settings: the descent with eta 0.01 and E0 1e-8.
        literal_rule: the descent with eq. (20) as printed.
        learning_rates: the descent with several learning rates.
        rate_curves: E along each of these runs, in the same order; (k,) each.
        stable_rates: the largest stable learning rate at the end of each motion.
        random_starts: all methods on random starts and poses; empty if not asked for.
        errata: the misprints.
        checks: what is claimed, and whether it holds here.
    """

    config: AppsConfig
    versions: dict[str, str]
    motions: tuple[Motion, ...]
    tables: Tables
    newton: tuple[NewtonRow, ...]
    newton_tool_frame: tuple[NewtonRow, ...]
    printed_settings: tuple[DescentRow, ...]
    literal_rule: tuple[DescentRow, ...]
    learning_rates: tuple[DescentRow, ...]
    rate_curves: tuple[Tensor, ...]
    stable_rates: tuple[float, ...]
    random_starts: tuple[RandomRow, ...]
    errata: tuple[Erratum, ...]
    checks: tuple[Check, ...]

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain dictionaries and lists; the curves and paths are left to the figures."""
        names = ["newton", "newton_tool_frame", "printed_settings", "literal_rule", "learning_rates"]
        names += ["random_starts", "errata", "checks"]
        return {
            "paper": "apps",
            "config": asdict(self.config) | {"learning_rates": list(self.config.learning_rates)},
            "versions": self.versions,
            "iterations": [row.iterations for row in self.tables.table6],
            **plain(asdict(self.tables)),
            "stable_rates": list(self.stable_rates),
            **{name: [plain(asdict(row)) for row in getattr(self, name)] for name in names},
        }


def run_study(config: AppsConfig | None = None, *, progress: Progress | None = None) -> AppsStudy:
    """Run all parts: about half a minute on two cores, most of it the learning rates and the random starts.

    Args:
        config: settings; default: `AppsConfig`.
        progress: called as ``progress(label, done, total)`` before every part.

    Example:
        >>> from ikgrad.config import AppsConfig
        >>> quick = AppsConfig(random_starts=0, learning_rates=(0.1,), learning_rate_max_steps=618)
        >>> run_study(quick).to_json()["iterations"]
        [438, 256, 316, 618, 278, 233, 281]
    """
    with one_thread():
        return _run(config or AppsConfig(), progress)


def _run(config: AppsConfig, progress: Progress | None) -> AppsStudy:
    methods = compare.random_methods(config) if config.random_starts else {}
    show = _counter(progress, total=7 + 3 + len(methods))
    apps = {"reproduces": Apps.reproduces(), "printed": Apps.printed()}[config.preset]

    motions = solve_motions(apps, tol_pos=config.tol_pos, tol_rot=config.tol_rot, progress=show)
    newton = [compare.newton_rows(motions, config, tool_frame_error=flag) for flag in (False, True)]
    show("printed settings and literal eq. (20)")
    printed = compare.descent_rows(motions, Apps.printed(), [Apps.printed().eta])
    literal = compare.descent_rows(motions, replace(Apps.reproduces(), literal=True), config.learning_rates)
    show("learning rates")
    longer = replace(Apps.reproduces(), max_steps=config.learning_rate_max_steps)
    rates = compare.descent_curves(motions, longer, config.learning_rates)
    random_rows = []
    for name, solver in methods.items():
        show(f"random starts: {name}")
        random_rows.append(compare.random_row(name, solver, config))
    show("tables")
    tables = all_tables(motions)
    return AppsStudy(
        config,
        {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
        tuple(motions),
        tables,
        newton=newton[0],
        newton_tool_frame=newton[1],
        printed_settings=printed,
        literal_rule=literal,
        learning_rates=tuple(row for row, _ in rates),
        rate_curves=tuple(curve for _, curve in rates),
        stable_rates=compare.stable_rates(motions),
        random_starts=tuple(random_rows),
        errata=errata(motions, literal, printed),
        checks=check(tables, newton[0], printed, literal),
    )


def _counter(progress: Progress | None, total: int) -> Callable[[str], None]:
    done = -1

    def show(label: str) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(label, done, total)

    return show
