"""Tables written chunk by chunk: CSV, NPY, NPZ, Parquet. The same chunks give the same bytes."""

from __future__ import annotations

import contextlib
import csv
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.lib import format as npy

from ikgrad.errors import DataError
from ikgrad.files.parquet_table import pyarrow_parquet
from ikgrad.files.places import check_suffix, in_one_move

SUFFIXES = (".csv", ".npy", ".npz", ".parquet")
Columns = dict[str, np.ndarray]  # name -> (k, ...), the same k for all
Words = Mapping[str, Sequence[str]]  # column -> what its numbers 0, 1, ... stand for


class Writer(Protocol):
    """Takes chunks of a table; all chunks have the same columns."""

    def append(self, columns: Columns) -> None:
        """Add rows."""

    def finish(self) -> None:
        """Complete the file."""

    def close(self) -> None:
        """Let go of everything, finished or not."""


@contextlib.contextmanager
def open_writer(
    path: Path,
    *,
    force: bool = False,
    folder: Path | None = None,
    constants: Columns | None = None,
    words: Words | None = None,
) -> Iterator[Writer]:
    """A writer for the kind of file that the suffix names; the file appears when the block ends well.

    Args:
        path: the file to be.
        force: overwrite an existing file.
        folder: where temporary files live; default: beside ``path``.
        constants: arrays that a ``.npz`` carries once, beside the columns.
        words: columns that are given as small numbers and written as words.
    """
    check_suffix(path, SUFFIXES)
    kind = path.suffix.lower()
    with in_one_move(path, force=force, folder=folder) as temporary:
        writer: Writer
        if kind == ".csv":
            writer = CsvWriter(temporary, words)
        elif kind == ".parquet":
            writer = ParquetWriter(temporary, words)
        else:
            writer = NumpyWriter(temporary, constants or {}, words)
        with contextlib.closing(writer):
            yield writer
            writer.finish()


class CsvWriter:
    """Numbers in the shortest form that reads back exactly."""

    def __init__(self, path: Path, words: Words | None = None):
        self._words = words or {}
        self._file = open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115 - closed by close
        self._csv = csv.writer(self._file, lineterminator="\n")
        self._started = False

    def append(self, columns: Columns) -> None:
        """Add rows; the header goes first."""
        if not self._started:
            self._csv.writerow(columns)
            self._started = True
        columns = in_words(columns, self._words)
        self._csv.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))

    def finish(self) -> None:
        """Nothing is left to do."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _cells(column: np.ndarray) -> list[Any]:
    return (np.where(column, "true", "false") if column.dtype == bool else column).tolist()


class ParquetWriter:
    """One row group a chunk.

    Random floats do not repeat, so they are written plainly; whole numbers and words go through dictionaries. Snappy
    costs next to nothing and halves the rest.

    Args:
        path: the file, for messages.
        words: columns that are given as small numbers and stored as a dictionary of words.
        sink: a binary file to write to; default: ``path``, opened here.
    """

    def __init__(self, path: Path, words: Words | None = None, sink: Any = None):
        self._path, self._words, self._sink = path, words or {}, sink
        self._file: Any = None
        self._pa, self._parquet = pyarrow_parquet(path)

    def append(self, columns: Columns) -> None:
        """Add rows."""
        table = self._pa.table({name: self._array(name, column) for name, column in columns.items()})
        if self._file is None:
            coded = [field.name for field in table.schema if not self._pa.types.is_floating(field.type)]
            target = self._path if self._sink is None else self._sink
            self._file = self._parquet.ParquetWriter(target, table.schema, use_dictionary=coded, compression="snappy")
        self._file.write_table(table)

    def _array(self, name: str, column: np.ndarray) -> Any:
        array = self._pa.array(np.ascontiguousarray(column))
        if name not in self._words or not self._pa.types.is_integer(array.type):
            return array
        return self._pa.DictionaryArray.from_arrays(array, self._pa.array(list(self._words[name])))

    def finish(self) -> None:
        """Write the footer."""
        if self._file is not None:
            file, self._file = self._file, None
            file.close()

    def close(self) -> None:
        """Close the file; an unfinished one is going to be removed, and a full disk may not even take its footer."""
        with contextlib.suppress(OSError):
            self.finish()


class NumpyWriter:
    """Each column grows in a file of its own; at the end they are put together with headers that know the length."""

    def __init__(self, path: Path, constants: Columns, words: Words | None = None):
        self._path, self._constants, self._words = path, constants, words or {}
        self._spools: dict[str, IO[bytes]] = {}
        self._kind: dict[str, tuple[np.dtype, tuple[int, ...]]] = {}
        self._rows = 0

    def append(self, columns: Columns) -> None:
        """Add rows."""
        columns = in_words(columns, self._words)
        if not self._spools:
            for name, column in columns.items():
                self._kind[name] = (column.dtype, column.shape[1:])
                self._spools[name] = open(self._spool(name), "w+b")  # noqa: SIM115
        for name, column in columns.items():
            dtype, shape = self._kind[name]
            assert column.dtype.itemsize <= dtype.itemsize, f"{name} outgrew {dtype}"
            assert column.shape[1:] == shape
            self._spools[name].write(np.ascontiguousarray(column, dtype=dtype).tobytes())
        self._rows += len(next(iter(columns.values())))

    def _spool(self, name: str) -> Path:
        return self._path.with_name(f"{self._path.name}.{len(self._spools)}")

    def finish(self) -> None:
        """Put headers before the data."""
        if self._path.suffix.lower() == ".npy":
            [name] = self._spools
            with open(self._path, "wb") as file:
                self._copy(name, file)
            return
        with zipfile.ZipFile(self._path, "w") as archive:
            for name, value in self._constants.items():
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as file:  # ZipInfo: no time of day in the file
                    npy.write_array(file, value, allow_pickle=False)
            for name in self._spools:
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
                    self._copy(name, file)

    def _copy(self, name: str, file: IO[bytes]) -> None:
        dtype, shape = self._kind[name]
        header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": (self._rows, *shape)}
        npy.write_array_header_1_0(file, header)
        self._spools[name].seek(0)
        shutil.copyfileobj(self._spools[name], file, 1 << 20)

    def close(self) -> None:
        """Remove the columns' own files."""
        for spool in self._spools.values():
            spool.close()
            Path(spool.name).unlink(missing_ok=True)


def text_column(values: np.ndarray, width: int = 16) -> np.ndarray:
    """Strings of one fixed width, so that every chunk has the same dtype.

    Raises:
        DataError: a text is longer.
    """
    if values.dtype.itemsize // 4 > width and max(map(len, values.tolist()), default=0) > width:
        raise DataError(f"text is longer than {width} characters")
    return values.astype(f"<U{width}")


def decoded(codes: np.ndarray, words: Sequence[str]) -> np.ndarray:
    """Words for numbers.

    Example:
        >>> decoded(np.array([1, 0]), ["no", "yes"]).tolist()
        ['yes', 'no']
    """
    return text_column(np.array(words)[codes])


def in_words(columns: Columns, words: Words) -> Columns:
    """The columns with words in place of the numbers that stand for them."""
    return {
        name: decoded(column, words[name]) if name in words and column.dtype.kind == "i" else column
        for name, column in columns.items()
    }
