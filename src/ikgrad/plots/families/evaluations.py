"""Evaluations of inverters: JSON of ``ikgrad evaluate`` and of a training run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ikgrad.errors import DataError
from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def find(looks: Sequence[Peek]) -> Found | None:
    """A document with evaluations, or a list of them."""
    document = looks[0].document
    records = document.get("evaluations") if isinstance(document, dict) else document
    return figures(records, title=looks[0].path.name) if records and is_evaluation(records) else None


def is_evaluation(records: Any) -> bool:
    """Whether these are evaluations as plain values."""
    return (
        isinstance(records, list)
        and bool(records)
        and all(isinstance(record, dict) and {"robot", "task", "rows"} <= record.keys() for record in records)
    )


def figures(records: Sequence[Mapping[str, Any]], *, title: str) -> Found:
    """What can be drawn from evaluations."""
    return {
        "methods": lambda options: _draw("methods", records, title),
        "speed": lambda options: _draw("speed", records, title),
    }


def _draw(kind: str, records: Sequence[Mapping[str, Any]], title: str) -> Figure:
    from ikgrad.plots.methods import method_errors, method_speed

    try:
        return {"methods": method_errors, "speed": method_speed}[kind](records, title=title)
    except (KeyError, TypeError, IndexError) as error:
        raise DataError(f"{title}: is no evaluation of this version of ikgrad: {error!r}") from error


FAMILY = Family("an evaluation of `ikgrad evaluate`", find)
