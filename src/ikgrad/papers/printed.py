"""The papers' printed tables: small CSV files with units in the header, shipped with the package."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

from ikgrad.errors import UnknownNameError

_FOLDER = Path(__file__).parent / "data"

Row = dict[str, str]


@cache
def read_table(name: str) -> tuple[Row, ...]:
    """Rows of a printed table as dictionaries of strings, column name to cell.

    Cells stay text, so that "printed to two decimals" and entries like ``FALSE`` are not lost.

    Args:
        name: file name without ``.csv``, such as ``"apps_table3"``.

    Raises:
        UnknownNameError: no such table.
    """
    path = _FOLDER / f"{name}.csv"
    if not path.is_file():
        raise UnknownNameError("paper table", name, sorted(p.stem for p in _FOLDER.glob("*.csv")))
    with path.open(newline="", encoding="utf-8") as file:
        return tuple(csv.DictReader(file))


def find_row(name: str, **where: str) -> Row:
    """The first row whose cells equal ``where``.

    Raises:
        UnknownNameError: no such table or row.
    """
    for row in read_table(name):
        if all(row.get(column) == value for column, value in where.items()):
            return row
    wanted = ", ".join(f"{column}={value}" for column, value in where.items())
    raise UnknownNameError(f"row of table '{name}'", wanted, [])


def numbers(row: Row, *columns: str) -> tuple[float, ...]:
    """Cells of a row as floats, in the order of ``columns``."""
    return tuple(float(row[column]) for column in columns)


__all__ = ["Row", "find_row", "numbers", "read_table"]
