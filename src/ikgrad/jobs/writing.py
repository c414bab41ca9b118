"""A partition on its way to the disk: hashed as it is written, timed, and in place in one move."""

from __future__ import annotations

import contextlib
import hashlib
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

from ikgrad.files.places import in_one_move
from ikgrad.files.writers import Columns, ParquetWriter, Words


class Clock:
    """Where the time goes, by name.

    Example:
        >>> clock = Clock()
        >>> with clock("work"):
        ...     pass
        >>> list(clock.seconds)
        ['work']
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    @contextlib.contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Count the time of a block."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.add(what, time.perf_counter() - begin)

    def add(self, what: str, seconds: float) -> None:
        """Count a time that was measured elsewhere."""
        self.seconds[what] = self.seconds.get(what, 0.0) + seconds

    def each(self, what: str, items: Iterable[Any]) -> Iterator[Any]:
        """Pass items on and count the time that they take to come."""
        iterator = iter(items)
        while True:
            with self(what):
                item = next(iterator, None)
            if item is None:
                return
            yield item

    def report(self) -> dict[str, float]:
        """All times so far, rounded, and the whole."""
        total = time.perf_counter() - self._begin
        return {name: round(value, 4) for name, value in (*self.seconds.items(), ("total", total))}


def peak_memory() -> int:
    """The most memory that this process has had so far [bytes]; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


class PartitionWriter:
    """Takes the rows of a partition; made by `partition_writer`.

    Attributes:
        rows: written so far.
        bytes: of the file, when it is finished.
        sha256: of what was written, which is more than what a second look would find there.
    """

    def __init__(self, path: Path, file: IO[bytes], clock: Clock, words: Words | None):
        self.rows, self.bytes, self.sha256 = 0, 0, ""
        self._clock, self._sink = clock, _HashedFile(file)
        self._writer = ParquetWriter(path, words, sink=self._sink)

    def append(self, columns: Columns) -> None:
        """Add a row group; the last one may be empty."""
        with self._clock("write"):
            self._writer.append(columns)
        self.rows += len(next(iter(columns.values())))

    def finish(self) -> None:
        """Write the footer."""
        with self._clock("write"):
            self._writer.finish()
        self._clock.add("hash", self._sink.seconds)
        self._clock.add("write", -self._sink.seconds)  # it took place inside
        self.bytes, self.sha256 = self._sink.bytes, self._sink.hash.hexdigest()

    def close(self) -> None:
        """Let go."""
        self._writer.close()


@contextlib.contextmanager
def partition_writer(path: Path, clock: Clock, words: Words | None = None) -> Iterator[PartitionWriter]:
    """A partition that appears, whole, when the block ends well, in place of one that may be there.

    Args:
        path: where it will lie.
        clock: gets the times ``write`` and ``hash``.
        words: see `ikgrad.files.writers.open_writer`.

    Raises:
        OSError: with the file's name, whatever failed.
    """
    try:
        with (
            in_one_move(path, force=True) as temporary,
            open(temporary, "wb") as file,
            contextlib.closing(PartitionWriter(path, file, clock, words)) as writer,
        ):
            yield writer
            writer.finish()
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


class _HashedFile:
    """What pyarrow needs of a file."""

    closed = False

    def __init__(self, file: IO[bytes]):
        self._file, self.hash, self.bytes, self.seconds = file, hashlib.sha256(), 0, 0.0

    def write(self, data: bytes) -> int:
        begin = time.perf_counter()
        self.hash.update(data)
        self.seconds += time.perf_counter() - begin
        self._file.write(data)
        self.bytes += len(data)
        return len(data)

    def flush(self) -> None:
        self._file.flush()

    def tell(self) -> int:
        return self.bytes

    def close(self) -> None:
        """The file is closed by who opened it."""
