"""Column names: found by name in any order; a missing or an unknown one is an error that says which."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from ikgrad.errors import DataError


class Table(Protocol):
    """A file of numbers, read in chunks."""

    total: int  # rows

    def chunks(self, rows: int) -> Iterator[np.ndarray]:
        """Arrays (k, ...) of float64, k = ``rows`` except at the end."""


def pick(where: str, found: Sequence[str], wanted: Sequence[str], ignored: Collection[str] = ()) -> list[int]:
    """Where each wanted column stands among those found.

    Args:
        where: file (and line), for the message.
        found: names in the file.
        wanted: names that must be there, in the order of the result.
        ignored: names that may be there as well.

    Raises:
        DataError: a column is missing, unknown or there twice.

    Example:
        >>> pick("a.csv", ["y", "x"], ["x", "y"])
        [1, 0]
        >>> pick("a.csv", ["x_m", "y"], ["x_m", "y_m"])
        Traceback (most recent call last):
        ikgrad.errors.DataError: a.csv: unknown column 'y'; did you mean 'y_m'? (expected x_m,y_m)
    """
    expected = f"(expected {_short(','.join(wanted), 400)})"
    for name in found:
        if name not in wanted and name not in ignored:
            close = difflib.get_close_matches(name, [w for w in wanted if w not in found], n=1, cutoff=0.4)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise DataError(f"{where}: unknown column '{_short(name)}'{hint} {expected}")
        if list(found).count(name) > 1:
            raise DataError(f"{where}: column '{_short(name)}' is there twice {expected}")
    missing = [name for name in wanted if name not in found]
    if missing:
        raise DataError(f"{where}: column '{_short(missing[0])}' is missing {expected}")
    return [list(found).index(name) for name in wanted]


def rechunk(arrays: Iterable[np.ndarray], rows: int) -> Iterator[np.ndarray]:
    """The same rows in arrays of exactly ``rows`` rows; the last may be shorter."""
    kept: list[np.ndarray] = []
    count = 0
    for array in arrays:
        while count + len(array) >= rows:
            cut = rows - count
            yield np.concatenate([*kept, array[:cut]])
            kept, count, array = [], 0, array[cut:]
        if len(array):
            kept.append(array)
            count += len(array)
    if kept:
        yield np.concatenate(kept)


def _short(text: str, length: int = 60) -> str:
    """Printable and of bounded length, whatever the file holds."""
    text = text if text.isprintable() else repr(text)[1:-1]
    return text if len(text) <= length else text[: length - 3] + "..."
