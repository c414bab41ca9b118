"""Where files go: outputs are checked before the work starts and appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path

from ikgrad.errors import DataError
from ikgrad.extras import check

HOST = re.sub(r"[^A-Za-z0-9-]", "-", platform.node())[:24] or "host"  # in names of temporary files, on shared folders


def check_input(path: Path, suffixes: Collection[str], kind: str | None = None) -> None:
    """Refuse an input that is not there, is a folder, or is of no known kind, which its suffix or ``kind`` says.

    Raises:
        DataError: with the file and what was expected.
    """
    if kind not in suffixes:
        check_suffix(path, suffixes)
    if not path.exists():
        raise DataError(f"{path}: no such file")
    if not path.is_file():
        raise DataError(f"{path}: is a folder, not a file" if path.is_dir() else f"{path}: is not a regular file")
    if not os.access(path, os.R_OK):
        raise DataError(f"{path}: cannot be read: permission denied")


def check_output(
    path: str | Path, suffixes: Collection[str], *, force: bool = False, inputs: Collection[str | Path] = ()
) -> Path:
    """Refuse an output that could not be written in the end; to be called before the work starts.

    Args:
        path: the file to be.
        suffixes: kinds of file that can be written, such as ``".csv"``.
        force: allow that the file exists.
        inputs: files that are read meanwhile and so can never be the output.

    Returns:
        The path.

    Raises:
        DataError: unknown suffix, no such folder, not writable, or the file exists.
        MissingExtraError: a Parquet file without pyarrow.

    Example:
        >>> check_output("joints.txt", [".csv", ".npz"])
        Traceback (most recent call last):
        ikgrad.errors.DataError: joints.txt: unknown kind of file '.txt' (known: .csv, .npz)
    """
    path = Path(path)
    check_suffix(path, suffixes)
    if path.suffix.lower() == ".parquet":
        check("pyarrow", extra="data", what=f"{path}: Parquet files")
    if not path.parent.is_dir():
        raise DataError(f"{path}: the folder '{path.parent}' does not exist; create it first")
    if path.is_dir():
        raise DataError(f"{path}: is a folder, not a file")
    if any(path.exists() and Path(other).exists() and path.samefile(other) for other in inputs):
        raise DataError(f"{path}: is the input; choose another name for the output")
    _refuse_existing(path, force)
    try:  # asking the file system is surer than reading permission bits
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise DataError(f"{path}: the folder '{path.parent}' is not writable: {error.strerror}") from error
    return path


def check_suffix(path: Path, suffixes: Collection[str]) -> None:
    """Refuse a file name that does not say one of the known kinds."""
    if path.suffix.lower() not in suffixes:
        raise DataError(f"{path}: unknown kind of file '{path.suffix}' (known: {', '.join(suffixes)})")


def _refuse_existing(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise DataError(f"{path}: exists already; it is overwritten with --force only")


@contextlib.contextmanager
def in_one_move(path: Path, *, force: bool = False, folder: Path | None = None, durable: bool = True) -> Iterator[Path]:
    """A temporary file to write to, which becomes ``path`` when the block ends well and is removed when it does not.

    Args:
        path: the final place.
        force: allow that ``path`` exists.
        folder: where the temporary file lives, on the same file system; default: beside ``path``.
        durable: wait until it is on the disk; without, a power cut may cut or undo what was just written.

    Yields:
        The temporary file's path (with the suffix of ``path``); nothing exists there yet.
    """
    temporary = (folder or path.parent) / f".{path.stem}.{HOST}.{os.getpid()}.tmp{path.suffix}"
    try:
        yield temporary
        if durable:
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
        _refuse_existing(path, force)  # it may have appeared meanwhile
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    if durable:
        _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Make the move itself survive a power cut, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
