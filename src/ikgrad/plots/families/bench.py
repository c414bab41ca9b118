"""Benchmarks: JSON of ``ikgrad bench``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ikgrad.errors import DataError
from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def find(looks: Sequence[Peek]) -> Found | None:
    """A document with a job and cells."""
    document = looks[0].document
    if not (isinstance(document, dict) and {"schema", "job", "cells"} <= document.keys()):
        return None
    return {"times": lambda options: _times(document, looks[0].path.name)}


def _times(document: dict[str, Any], name: str) -> Figure:
    from ikgrad.plots.race import solver_times

    try:
        return solver_times(document["cells"], title=f"ikgrad bench {document['job']}: {document['title']}")
    except (KeyError, TypeError) as error:
        raise DataError(f"{name}: is no benchmark of this version of ikgrad: {error!r}") from error


FAMILY = Family("a benchmark of `ikgrad bench`", find)
