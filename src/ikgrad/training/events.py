"""Events for TensorBoard: the curves of every network, in a folder of its own so that they lie over each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ikgrad.errors import DataError
from ikgrad.extras import check

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter


class Point(NamedTuple):
    """Some values at a step or epoch."""

    step: int
    values: Mapping[str, float]


def require_tensorboard() -> None:
    """Refuse before any work if the package is not there.

    Raises:
        MissingExtraError: with the extra that brings it.
    """
    check("tensorboard", extra="train", what="tensorboard: events")


class Events:
    """Writes what is new in the curves.

    Args:
        folder: holds a folder ``seed-<seed>`` for every network.
        seeds: of the networks.
        points: (k, start) -> the points of curve k from its point ``start`` on. What is there now was written by the
            part of the run before; later points in the files are taken back.
    """

    def __init__(self, folder: Path, seeds: Sequence[int], points: Callable[[int, int], Sequence[Point]]):
        self.folder, self.seeds, self.points = folder, seeds, points
        before = [points(k, 0) for k in range(len(seeds))]
        self.written = [len(curve) for curve in before]
        self._after = [curve[-1].step + 1 if curve else 0 for curve in before]
        self._writers: list[SummaryWriter] = []

    def write(self) -> None:
        """Append what is new, and see to it that it is on disk.

        Raises:
            DataError: it cannot be written.
        """
        try:
            self._append()
        except OSError as error:
            raise DataError(f"{self.folder}: cannot write the events: {error.strerror}") from error

    def close(self) -> None:
        """Close the files."""
        for writer in self._writers:
            writer.close()

    def _append(self) -> None:
        if not self._writers:
            self._open()
        for k, writer in enumerate(self._writers):
            new = self.points(k, self.written[k])
            for step, values in new:
                for name, value in values.items():
                    writer.add_scalar(name, value, step)
            self.written[k] += len(new)
            writer.flush()

    def _open(self) -> None:
        from torch.utils.tensorboard import SummaryWriter

        for seed, after in zip(self.seeds, self._after, strict=True):
            self._writers.append(SummaryWriter(str(self.folder / f"seed-{seed}"), purge_step=after))


__all__ = ["Events", "Point", "require_tensorboard"]
