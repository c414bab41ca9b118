"""What a file is, told by its content: its first bytes, its columns, the shape of its array."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.npy_table import npz_names
from ikgrad.files.parquet_table import parquet_columns

_HEAD = 1 << 16  # bytes that are looked at


@dataclass(frozen=True)
class Peek:
    """A look at a file or folder.

    Attributes:
        path: the place.
        kind: ``.csv``, ``.parquet``, ``.npy``, ``.npz``, ``.json``, ``.xml``, ``folder``, or empty for anything else.
        columns: of a table, or names of the arrays in an ``.npz``.
        shape: of the array in an ``.npy``.
        document: what a JSON file says.
    """

    path: Path
    kind: str
    columns: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    document: Any = None

    def is_table(self) -> bool:
        """Whether it has named columns of rows."""
        return self.kind in (".csv", ".parquet")


def peek(path: str | Path) -> Peek:
    r"""Look at a file or folder.

    Raises:
        DataError: there is none, it cannot be read, or it begins like a kind of file and is damaged.
        MissingExtraError: a Parquet file without pyarrow.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp(), "numbers.txt")
        >>> _ = path.write_text("x_m,y_m\n1,2\n")
        >>> peek(path).kind, peek(path).columns
        ('.csv', ('x_m', 'y_m'))
    """
    path = Path(path)
    if path.is_dir():
        return Peek(path, "folder")
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file or folder") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    return _binary(path, head) or _text(path, head.decode("utf-8-sig", errors="replace"))


def _binary(path: Path, head: bytes) -> Peek | None:
    if head.startswith(b"PAR1"):
        return Peek(path, ".parquet", tuple(parquet_columns(path)))
    if head.startswith(b"\x93NUMPY"):
        try:
            return Peek(path, ".npy", shape=np.load(path, mmap_mode="r", allow_pickle=False).shape)
        except (ValueError, OSError, EOFError) as error:
            raise DataError(f"{path}: is not a readable .npy file: {error}") from error
    if head.startswith(b"PK"):
        return Peek(path, ".npz", tuple(npz_names(path)))
    return None


def _text(path: Path, head: str) -> Peek:
    start = head.lstrip()[:1]
    if start in ("{", "["):
        try:
            return Peek(path, ".json", document=json.loads(path.read_text(encoding="utf-8-sig")))
        except (ValueError, RecursionError) as error:
            raise DataError(f"{path}: is no JSON document: {error}") from error
    if start == "<":
        return Peek(path, ".xml")
    line = head.partition("\n")[0].strip()
    if "," in line and line.isprintable():
        return Peek(path, ".csv", tuple(name.strip() for name in next(csv.reader([line]))))
    return Peek(path, "")


__all__ = ["Peek", "peek"]
