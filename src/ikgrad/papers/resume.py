"""Trainings that may be cut off: a checkpoint beside each, from which the next run goes on to the same numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from ikgrad.errors import DataError
from ikgrad.training import Training, load_checkpoint, save_checkpoint

CHECKPOINT_EVERY = 10.0  # seconds: what a kill may cost


class Watch:
    """Told after epochs: counts them and the time, and writes the checkpoint now and then.

    A context: on entering it the checkpoint is read, if there is one; on leaving it without an error the last one is
    written. `Training.run` belongs inside, with the watch as its ``after_epoch``.

    Args:
        training: goes on where the checkpoint stood.
        settings: what the training depends on, plain values, ``"epochs"`` among them; a checkpoint of others is
            refused.
        checkpoint: its file; None: nothing is kept.
        count: called with the number of epochs done since it was last called, those of an earlier run included. A
            KeyboardInterrupt that it raises ends the training between two epochs, checkpoint first.

    Attributes:
        seconds: of training, earlier runs included.

    Raises:
        DataError: on entering, the checkpoint is of other settings, or damaged.

    Example:
        >>> import tempfile, torch
        >>> from ikgrad import optim
        >>> from ikgrad.networks import MLP
        >>> from ikgrad.training import Batches
        >>> def trained(epochs, folder):
        ...     network = MLP((1, 3, 1), seeds=0)
        ...     data = Batches(torch.ones(1, 1).double(), torch.zeros(1, 1).double())
        ...     training = Training(network, optim.Backprop(network.parameters(), 0.1), data)
        ...     with Watch(training, {"epochs": 9}, Path(folder, "mine.ckpt")) as watch:
        ...         before = training.epoch
        ...         training.run(epochs, after_epoch=watch)
        ...     return before, training.epoch
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     trained(4, folder), trained(9, folder)
        ((0, 4), (4, 9))
    """

    def __init__(
        self,
        training: Training,
        settings: Mapping[str, Any],
        checkpoint: Path | None,
        *,
        count: Callable[[int], object] | None = None,
    ):
        self.training, self.settings, self.checkpoint, self.count = training, dict(settings), checkpoint, count
        self.seconds = 0.0
        self._counted = 0

    def __enter__(self) -> Watch:
        if self.checkpoint is not None and self.checkpoint.exists():
            self._load(self.checkpoint)
        self._start = self._written = time.monotonic()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        if kind is not None:
            return
        self._save()
        self._count(self.settings["epochs"])  # networks that diverged or stopped are spared some

    def __call__(self, training: Training) -> None:
        """After an epoch."""
        if time.monotonic() - self._written > CHECKPOINT_EVERY:
            self._save()
        try:
            self._count(training.epoch)
        except KeyboardInterrupt:  # between two epochs: nothing is half done
            self._save()
            raise

    def _count(self, epoch: int) -> None:
        new, self._counted = epoch - self._counted, epoch
        if new and self.count is not None:
            self.count(new)

    def _load(self, checkpoint: Path) -> None:
        saved = load_checkpoint(checkpoint)
        for key, value in self.settings.items():
            was = saved["settings"].get(key)
            if was != value:
                raise DataError(f"{checkpoint}: is of a run with {key} {was}, not {value}; --force starts anew")
        self.training.load_state_dict(saved["training"])
        self.seconds = saved["seconds"]

    def _save(self) -> None:
        now = time.monotonic()
        self.seconds += now - self._start
        self._start = now
        if self.checkpoint is not None:
            state = {"settings": self.settings, "training": self.training.state_dict(), "seconds": self.seconds}
            save_checkpoint(self.checkpoint, state)
            self._written = time.monotonic()


__all__ = ["Watch"]
