"""Maps of ``ikgrad map``: what a robot reaches, voxel by voxel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("x_m", "y_m", "z_m", "share", "condition")


def find(looks: Sequence[Peek]) -> Found | None:
    """A table with places, shares and condition numbers."""
    look = looks[0]
    drawable = look.is_table() and set(COLUMNS) <= set(look.columns)
    return {"map": lambda options: _map(look)} if drawable else None


def _map(look: Peek) -> Figure:
    from ikgrad.files.csv_table import CsvTable
    from ikgrad.files.parquet_table import ParquetTable
    from ikgrad.plots.maps import workspace_map

    table = (CsvTable if look.kind == ".csv" else ParquetTable)(look.path, look.columns)
    wanted = [look.columns.index(name) for name in COLUMNS]
    rows = np.concatenate([rows[:, wanted] for rows in table.chunks(65_536)])
    return workspace_map(rows[:, :3], rows[:, 3], rows[:, 4], title=f"{look.path.name}: {len(rows):,} cells")


FAMILY = Family("a map", find)
