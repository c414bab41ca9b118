"""NumPy files (``.npy``, and one array of a ``.npz``), read front to back in bounded memory."""

from __future__ import annotations

import contextlib
import math
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from ikgrad.errors import DataError


def npz_names(path: Path) -> list[str]:
    """Names of the arrays in a ``.npz`` file.

    Raises:
        DataError: not a readable ``.npz`` file.
    """
    with _as_data_error(path), zipfile.ZipFile(path) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


class NpyTable:
    """An array (N, *row_shape) of real numbers.

    Args:
        path: a ``.npy`` file, or a ``.npz`` file together with ``member``.
        row_shape: what one row must look like.
        member: name of the array in a ``.npz`` file.

    Raises:
        DataError: not readable, truncated, of another shape, not of real numbers, or without rows.
    """

    def __init__(self, path: Path, row_shape: tuple[int, ...], member: str | None = None):
        self.path, self.member, self.row_shape = path, member, row_shape
        with self._open() as (_, shape, dtype, _):
            pass
        expected = "(N, " + ", ".join(map(str, row_shape)) + ")"
        if shape[1:] != row_shape or not shape:
            raise DataError(f"{self._name}: expected shape {expected}, got {shape}")
        if dtype.kind not in "fiu":
            raise DataError(f"{self._name}: expected real numbers, got {dtype}")
        self.total = shape[0]
        if not self.total:
            raise DataError(f"{self._name}: has no rows")

    @property
    def _name(self) -> str:
        return f"{self.path}" if self.member is None else f"{self.path}, array '{self.member}'"

    def chunks(self, rows: int) -> Iterator[np.ndarray]:
        """Arrays (k, *row_shape) of float64."""
        with self._open() as (stream, shape, dtype, fortran):
            if fortran and len(shape) > 1:  # stored column by column: there is no front to read first
                whole = self._read(stream, shape[::-1], dtype).transpose()
                for first in range(0, self.total, rows):
                    yield np.array(whole[first : first + rows], dtype=np.float64, order="C")
                return
            for first in range(0, self.total, rows):
                count = min(rows, self.total - first)
                yield self._read(stream, (count, *self.row_shape), dtype).astype(np.float64)

    def _read(self, stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        size = math.prod(shape) * dtype.itemsize
        with _as_data_error(self.path):
            data = stream.read(size)
        if len(data) != size:
            raise DataError(f"{self._name}: is truncated, its header promises {self.total} rows")
        return np.frombuffer(data, dtype).reshape(shape)

    @contextlib.contextmanager
    def _open(self) -> Iterator[tuple[IO[bytes], tuple[int, ...], np.dtype, bool]]:
        """The stream behind the header, and the shape, the dtype and the order that the header names."""
        with contextlib.ExitStack() as stack:
            with _as_data_error(self.path):
                if self.member is None:
                    stream: IO[bytes] = stack.enter_context(open(self.path, "rb"))
                else:
                    archive = stack.enter_context(zipfile.ZipFile(self.path))
                    stream = stack.enter_context(archive.open(self.member + ".npy"))
                shape, fortran, dtype = _header(stream)
            self._check_size(stream, shape, dtype)
            yield stream, shape, dtype, fortran

    def _check_size(self, stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype) -> None:
        if self.member is None and not dtype.hasobject:  # a .npz says so itself, it ends with its table of contents
            there = self.path.stat().st_size - stream.tell()
            if there < math.prod(shape) * dtype.itemsize:
                raise DataError(f"{self._name}: is truncated, its header promises shape {shape}")


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    read: dict[tuple[int, int], Any] = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    version = npy.read_magic(stream)
    if version not in read:
        raise ValueError(f"unknown version {version}")
    shape, fortran, dtype = read[version](stream)
    return shape, fortran, dtype


@contextlib.contextmanager
def _as_data_error(path: Path) -> Iterator[None]:
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, KeyError, NotImplementedError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise DataError(f"{path}: is not a readable {path.suffix} file: {reason}") from error
