"""Parquet files of numbers, by pyarrow (optional extra ``data``)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ikgrad.errors import DataError
from ikgrad.extras import need
from ikgrad.files.columns import pick, rechunk

READ_AHEAD = 1 << 18  # bytes a column


def pyarrow_parquet(path: Path) -> tuple[Any, Any]:
    """The modules ``pyarrow`` and ``pyarrow.parquet``.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    what = f"{path}: Parquet files"
    return need("pyarrow", extra="data", what=what), need("pyarrow.parquet", extra="data", what=what)


def parquet_columns(path: Path) -> list[str]:
    """Names of the columns.

    Raises:
        DataError: not a readable Parquet file.
        MissingExtraError: pyarrow is not installed.
    """
    with _open(path) as file:
        return [str(name) for name in file.schema_arrow.names]


def parquet_column(path: Path, name: str) -> np.ndarray:
    """One whole column, of whatever kind.

    Raises:
        DataError: not a readable Parquet file.
        KeyError: there is no such column.
    """
    with _open(path) as file:
        return np.asarray(file.read(columns=[name])[name].to_numpy())


class ParquetTable:
    """The wanted columns of a Parquet file, read in batches. A null is a missing number, NaN.

    Args:
        path: the file.
        wanted: columns to read, in this order.
        ignored: columns that may be there too and are not read.
        empty: a file without rows is welcome.

    Raises:
        DataError: not a Parquet file, a wrong column, a column that holds no numbers, no rows.
    """

    def __init__(self, path: Path, wanted: Sequence[str], ignored: Collection[str] = (), *, empty: bool = False):
        self.path, self.wanted = path, list(wanted)
        pa, _ = pyarrow_parquet(path)
        with _open(self.path) as file:
            schema, self.total = file.schema_arrow, file.metadata.num_rows
        pick(str(path), schema.names, self.wanted, {*ignored, "__index_level_0__"})  # pandas' row labels
        for name in self.wanted:
            kind = schema.field(name).type
            if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
                raise DataError(f"{path}: column '{name}' must hold numbers, got {kind}")
        if not self.total and not empty:
            raise DataError(f"{path}: has columns but no rows")

    def chunks(self, rows: int) -> Iterator[np.ndarray]:
        """Arrays (k, columns) of float64."""
        return rechunk(self._batches(rows), rows)

    def _batches(self, rows: int) -> Iterator[np.ndarray]:
        pa, _ = pyarrow_parquet(self.path)
        with _open(self.path) as file:
            try:
                for batch in file.iter_batches(batch_size=rows, columns=self.wanted):
                    columns = [
                        batch.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False) for name in self.wanted
                    ]
                    yield np.stack(columns, axis=1)
            except (pa.ArrowException, OSError) as error:
                raise DataError(f"{self.path}: is damaged: {_first_line(error)}") from error


def _open(path: Path) -> Any:
    pa, parquet = pyarrow_parquet(path)
    try:
        # by default the whole file is read ahead; a small buffer also streams a file of one row group
        return parquet.ParquetFile(path, pre_buffer=False, buffer_size=READ_AHEAD)
    except (pa.ArrowException, OSError) as error:
        raise DataError(f"{path}: is not a readable Parquet file: {_first_line(error)}") from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
