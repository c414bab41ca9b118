"""Events for TensorBoard: the curves of every network, in a folder of its own so that they lie over each other."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.errors import ConfigError
from ikgrad.training.result import Curve

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter


def require_tensorboard() -> None:
    """Refuse before any work if the package is not there.

    Raises:
        ConfigError: with the extra that brings it.
    """
    if importlib.util.find_spec("tensorboard") is None:
        raise ConfigError("tensorboard: the package is not installed; pip install 'ikgrad[train]' brings it")


class Events:
    """Writes what is new in the curves.

    Args:
        folder: holds a folder ``seed-<seed>`` for every network.
        seeds: of the networks.
        curves: what is written already, by the part of the run before; later epochs in the files are taken back.
    """

    def __init__(self, folder: Path, seeds: Sequence[int], curves: Sequence[Curve]):
        self.folder, self.seeds = folder, seeds
        self.written = [len(curve.epochs) for curve in curves]
        self._writers: list[SummaryWriter] = []

    def write(self, curves: Sequence[Curve]) -> None:
        """Append what is new, and see to it that it is on disk."""
        if not self._writers:
            self._open(curves)
        for k, (writer, curve) in enumerate(zip(self._writers, curves, strict=True)):
            for i in range(self.written[k], len(curve.epochs)):
                epoch = int(curve.epochs[i])
                writer.add_scalar("loss/train", curve.train[i].item(), epoch)
                if curve.validation is not None:
                    writer.add_scalar("loss/validation", curve.validation[i].item(), epoch)
            self.written[k] = len(curve.epochs)
            writer.flush()

    def close(self) -> None:
        """Close the files."""
        for writer in self._writers:
            writer.close()

    def _open(self, curves: Sequence[Curve]) -> None:
        from torch.utils.tensorboard import SummaryWriter

        for seed, done, curve in zip(self.seeds, self.written, curves, strict=True):
            after = int(curve.epochs[done - 1]) + 1 if done else 0
            self._writers.append(SummaryWriter(str(self.folder / f"seed-{seed}"), purge_step=after))


__all__ = ["Events", "require_tensorboard"]
