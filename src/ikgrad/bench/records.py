"""What a benchmark returns: plain records that a table shows and JSON keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ikgrad.bench.statistics import Interval

SCHEMA = 1  # of the JSON document; goes up when a field changes its meaning


@dataclass(frozen=True)
class Cell:
    """One solver on one robot with one batch size and number of threads.

    Times are seconds a row (a pose, a configuration, a point of a path). ``ratio`` says how many times slower than
    ikgrad, timed in turns in the same run.
    """

    robot: str
    solver: str
    batch: int
    threads: int
    job: str = "ik"
    version: str = ""
    rows: int = 0  # rows that were timed and judged
    calls: int = 0
    solved: int | None = None
    outside: int | None = None  # answers outside the limits
    late: int | None = None  # solved, but after the cap
    median: float | None = None  # [s] of the calls, a row
    percentile_95: float | None = None
    mean: Interval | None = None  # [s] median over the rounds of the time a row, with its interval
    ratio: Interval | None = None
    errors: Mapping[str, float] = field(default_factory=dict)  # percentiles of position_mm and rotation_deg
    reasons: Mapping[str, int] = field(default_factory=dict)  # ours: rows per reason
    extra: Mapping[str, float] = field(default_factory=dict)  # what only this protocol measures
    missing: str | None = None  # why there is no measurement

    @property
    def success(self) -> float | None:
        """Solved share."""
        return None if self.solved is None or not self.rows else self.solved / self.rows

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        record = {**asdict(self), "success": self.success}
        for name in ("mean", "ratio"):
            interval: Interval | None = getattr(self, name)
            record[name] = None if interval is None else interval._asdict()
        return record


@dataclass(frozen=True)
class Report:
    """A whole run.

    Attributes:
        job: ik, fk or jacobian.
        title: what was done, in one line.
        cells: the results.
        environment: machine, versions and date, see `environment`.
        settings: what was asked for.
        solvers: how each solver was run, in words.
    """

    job: str
    title: str
    cells: tuple[Cell, ...]
    environment: Mapping[str, Any]
    settings: Mapping[str, Any]
    solvers: Mapping[str, str]

    def to_json(self) -> dict[str, Any]:
        """One JSON document; what is not finite is null."""
        document = {
            "schema": SCHEMA,
            "job": self.job,
            "title": self.title,
            "environment": dict(self.environment),
            "settings": dict(self.settings),
            "solvers": dict(self.solvers),
            "cells": [cell.to_json() for cell in self.cells],
        }
        return {name: _finite(value) for name, value in document.items()}


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
