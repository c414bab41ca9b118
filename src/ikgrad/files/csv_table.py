"""CSV files of numbers: a header line, commas, one row a line. An empty cell or ``nan`` is a missing number."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.columns import _short, pick, rechunk


class CsvTable:
    """The wanted columns of a CSV file, read in blocks of lines.

    Args:
        path: the file.
        wanted: columns to read, in this order.
        ignored: columns that may be there too and are not parsed.

    Raises:
        DataError: no header, a wrong column, no rows; while reading: a cell that is no number, a short or long row.
    """

    def __init__(self, path: Path, wanted: Sequence[str], ignored: Collection[str] = ()):
        self.path, self.wanted = path, list(wanted)
        with self._open() as file:
            self.found = self._header(file)
            self.index = pick(f"{path}, line 1", self.found, self.wanted, ignored)
            self.total = sum(not line.isspace() for line in file)
        if not self.total:
            raise DataError(f"{path}: has a header but no rows")

    def chunks(self, rows: int) -> Iterator[np.ndarray]:
        """Arrays (k, columns) of float64."""
        return rechunk(self._blocks(rows), rows)

    def _blocks(self, rows: int) -> Iterator[np.ndarray]:
        with self._open() as file:
            next(file)
            line = 2
            while block := list(islice(file, rows)):
                yield self._parse(block, line)
                line += len(block)

    def _open(self) -> TextIO:
        # a byte that is no UTF-8 becomes a sign that is no number, so that the message can name line and column
        return open(self.path, encoding="utf-8-sig", errors="replace")

    def _header(self, file: TextIO) -> list[str]:
        expected = ",".join(self.wanted)
        first = file.readline()
        if not first.strip():
            raise DataError(f"{self.path}: is empty; expected the header {expected}")
        names = [name.strip() for name in self._cells(first, 1)]
        if all(_number(name) is not None for name in names):
            raise DataError(f"{self.path}, line 1: the header is missing; expected {expected}")
        if len(names) == 1 and len(self.wanted) > 1:
            shown = _short(first.strip())
            raise DataError(f"{self.path}, line 1: expected the columns {expected} with commas between, got '{shown}'")
        return names

    def _parse(self, lines: list[str], first: int) -> np.ndarray:
        """Quickly if all is well; a second, careful pass finds the line and column that are not."""
        commas = len(self.found) - 1
        if all(line.count(",") == commas and not line.isspace() for line in lines):
            try:
                return np.loadtxt(lines, delimiter=",", comments=None, usecols=self.index, ndmin=2, dtype=np.float64)
            except ValueError:
                pass
        rows = [self._row(line, first + k) for k, line in enumerate(lines) if not line.isspace()]
        return np.array(rows, dtype=np.float64).reshape(-1, len(self.index))

    def _row(self, line: str, number: int) -> list[float]:
        cells = self._cells(line, number)
        if len(cells) != len(self.found):
            raise DataError(f"{self.path}, line {number}: expected {len(self.found)} values, got {len(cells)}")
        row = []
        for column in self.index:
            value = _number(cells[column])
            if value is None:
                where = f"{self.path}, line {number}, column '{_short(self.found[column])}'"
                raise DataError(f"{where}: expected a number, got '{_short(cells[column].strip())}'")
            row.append(value)
        return row

    def _cells(self, line: str, number: int) -> list[str]:
        try:
            return next(csv.reader([line]))
        except csv.Error as error:
            raise DataError(f"{self.path}, line {number}: is not CSV text ({error})") from error


def _number(text: str) -> float | None:
    """The number in a cell, NaN for an empty one (as pandas writes it), None for text that is no number."""
    if not text.strip():
        return float("nan")
    try:
        return None if "_" in text else float(text)  # Python would read 1_0 as 10
    except ValueError:
        return None
