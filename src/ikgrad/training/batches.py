"""Patterns in memory, handed out epoch by epoch: all at once, in pieces or one by one, in fixed or random order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from ikgrad.errors import DataError, ShapeError


class Batches:
    """The data of a training: pairs of inputs and targets, and the order in which they are shown.

    Online, mini-batch and batch learning differ by ``batch_size`` alone: 1, something between, or None for all.

    Args:
        x: (N, inputs), or (S, N, inputs) where each of S stacked networks has data of its own.
        y: (N, outputs) or (S, N, outputs).
        batch_size: patterns a step; None: all of them.
        shuffle: None: fixed order. Otherwise the seeds of new random orders every epoch, one int for all, or one for
            each of the S networks (a negative one keeps that network's order fixed). The order of a network depends on
            its own seed alone, not on what it is stacked with.

    Raises:
        ShapeError: x and y do not belong together, or not one seed a network.
        DataError: no patterns, or one that is not finite.

    Example:
        >>> data = Batches(torch.arange(3.0)[:, None], torch.zeros(3, 1), batch_size=2)
        >>> [x.flatten().tolist() for x, y in data.epoch()]
        [[0.0, 1.0], [2.0]]
    """

    def __init__(
        self, x: Tensor, y: Tensor, *, batch_size: int | None = None, shuffle: int | Sequence[int] | None = None
    ):
        _check(x, y, batch_size)
        self.x, self.y = x, y
        self.count = x.shape[-2]
        self.batch_size = min(batch_size or self.count, self.count)
        seeds = [] if shuffle is None else [shuffle] if isinstance(shuffle, int) else list(shuffle)
        if len(seeds) > 1 and x.shape[:-2] != (len(seeds),):
            raise ShapeError(f"{len(seeds)} seeds for data of shape {tuple(x.shape)}; one for each stacked network")
        self._generators = [None if seed < 0 else torch.Generator().manual_seed(seed) for seed in seeds]

    @property
    def steps(self) -> int:
        """Batches an epoch."""
        return -(-self.count // self.batch_size)

    def epoch(self) -> Iterator[tuple[Tensor, Tensor]]:
        """One pass over all patterns."""
        x, y = self._in_order()
        if self.steps == 1:
            yield x, y
            return
        yield from zip(x.split(self.batch_size, -2), y.split(self.batch_size, -2), strict=True)

    def orders(self, epochs: int) -> Tensor | None:
        """Draw the orders of the next epochs.

        Returns:
            (epochs, S, N) which pattern comes when for each network, or (epochs, 1, N) for one order for all; None
            where all orders are fixed.
        """
        if all(generator is None for generator in self._generators):
            return None
        fixed = torch.arange(self.count).expand(epochs, -1)
        orders = [fixed if g is None else self._shuffled(epochs, g) for g in self._generators]
        return torch.stack(orders, 1)

    def _shuffled(self, epochs: int, generator: torch.Generator) -> Tensor:
        """Sorting random keys: many epochs in one call, and the same orders however epochs are split over calls."""
        keys = torch.rand(epochs, self.count, dtype=torch.float64, generator=generator)
        return keys.argsort(stable=True, dim=-1)

    def _in_order(self) -> tuple[Tensor, Tensor]:
        orders = self.orders(1)
        if orders is None:
            return self.x, self.y
        order = orders[0].to(self.x.device)
        if len(order) == 1:
            return self.x[..., order[0], :], self.y[..., order[0], :]
        return self.x.take_along_dim(order[..., None], -2), self.y.take_along_dim(order[..., None], -2)

    def state_dict(self) -> dict[str, Any]:
        """Where the random orders stand."""
        return {"generators": [torch.empty(0) if g is None else g.get_state() for g in self._generators]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on with the orders where they stood."""
        for generator, saved in zip(self._generators, state["generators"], strict=True):
            if generator is not None:
                generator.set_state(saved)


def _check(x: Tensor, y: Tensor, batch_size: int | None) -> None:
    if x.ndim not in (2, 3) or y.ndim != x.ndim or x.shape[:-1] != y.shape[:-1]:
        raise ShapeError(f"x and y must be (N, k) or (S, N, k) with the same N, got {tuple(x.shape)}, {tuple(y.shape)}")
    if x.shape[-2] == 0:
        raise DataError("the data set is empty; there is nothing to learn from")
    if batch_size is not None and batch_size < 1:
        raise ValueError(f"batch_size must be at least 1, got {batch_size}")
    for name, data in (("x", x), ("y", y)):
        if not data.isfinite().all():
            place = (~data.isfinite()).nonzero()[0].tolist()
            raise DataError(f"{name}{place} is {data[tuple(place)].item()}; the data must be finite")


__all__ = ["Batches"]
