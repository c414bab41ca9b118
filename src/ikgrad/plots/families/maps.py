"""Maps of ``ikgrad map``: what a robot reaches, voxel by voxel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("x_m", "y_m", "z_m", "share")


def find(looks: Sequence[Peek]) -> Found | None:
    """A table with places and shares."""
    from ikgrad import plots

    look = looks[0]
    drawable = look.is_table() and set(COLUMNS) <= set(look.columns) and hasattr(plots, "workspace_map")
    return {"map": lambda options: _map(look)} if drawable else None


def _map(look: Peek) -> Figure:
    from ikgrad import plots

    return plots.workspace_map(_columns(look))  # type: ignore[attr-defined]


def _columns(look: Peek) -> dict[str, np.ndarray]:
    """Every column (N,) of the table."""
    from ikgrad.files.csv_table import CsvTable
    from ikgrad.files.parquet_table import ParquetTable

    table = (CsvTable if look.kind == ".csv" else ParquetTable)(look.path, look.columns)
    rows = np.concatenate(list(table.chunks(65_536)))
    return dict(zip(look.columns, rows.T, strict=True))


FAMILY = Family("a map", find)
