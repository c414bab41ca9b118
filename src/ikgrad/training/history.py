"""What a training leaves behind: losses at some epochs, one column for each stacked network."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor


@dataclass
class History:
    """Mean squared errors along a training.

    Attributes:
        epochs: at which they were taken, ascending.
        train: mean squared error on the training data, one tensor (S,) an epoch, S = 1 for a single network.
        validation: the same on the validation data; empty without any.
    """

    epochs: list[int] = field(default_factory=list)
    train: list[Tensor] = field(default_factory=list)
    validation: list[Tensor] = field(default_factory=list)

    def add(self, epoch: int, train: Tensor, validation: Tensor | None) -> None:
        """Append one epoch."""
        self.epochs.append(epoch)
        self.train.append(train)
        if validation is not None:
            self.validation.append(validation)

    def train_table(self) -> Tensor:
        """(epochs, S) mean squared errors on the training data."""
        return torch.stack(self.train)

    def validation_table(self) -> Tensor:
        """(epochs, S) mean squared errors on the validation data."""
        return torch.stack(self.validation)


def log_epochs(last: int, *, per_decade: int = 20) -> list[int]:
    """Epochs evenly spaced on a logarithmic axis, 1 and ``last`` among them: for curves over many decades.

    Example:
        >>> log_epochs(100, per_decade=3)
        [1, 2, 5, 10, 22, 46, 100]
    """
    grid = {round(10.0 ** (k / per_decade)) for k in range(per_decade * len(str(last)) + 1)}
    return sorted({epoch for epoch in grid if epoch < last} | {last})


__all__ = ["History", "log_epochs"]
