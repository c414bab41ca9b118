"""Processes that share one training: each learns from its rows of every batch, and all take the same steps.

Gradients are added up by one explicit all-reduce a step. ``DistributedDataParallel`` would add nothing: it wraps one
call of one module, while a training calls its network once a round with the chain in between, and hides the time of
messages behind that of layers, of which small networks have none to speak of.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch import distributed as dist

from ikgrad.errors import ConfigError, DataError, IkgradError

_BACKENDS = "cpu:gloo,cuda:nccl"
Value = TypeVar("Value")


@dataclass(frozen=True)
class Processes:
    """One of some processes; alone, every method does nothing and costs nothing.

    Attributes:
        rank: which one this is, from 0.
        size: how many there are.

    Example:
        >>> Processes().rows(100), Processes(rank=2, size=3).rows(100)
        (slice(0, 100, None), slice(66, 100, None))
    """

    rank: int = 0
    size: int = 1

    @property
    def first(self) -> bool:
        """True for the one that decides, writes and prints."""
        return self.rank == 0

    def rows(self, count: int) -> slice:
        """The share of ``count`` rows that is this process's own.

        Raises:
            ConfigError: there are fewer rows than processes.
        """
        if count < self.size:
            raise ConfigError(f"batch_size {count} is too small for {self.size} processes; each needs a row")
        return slice(self.rank * count // self.size, (self.rank + 1) * count // self.size)

    def add_up(self, numbers: Tensor) -> Tensor:
        """The sum over all processes, in place."""
        if self.size > 1:
            dist.all_reduce(numbers)
        return numbers

    def from_first(self, value: float) -> float:
        """The first process's value: what all decide by."""
        if self.size == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64)
        dist.broadcast(shared, src=0)
        return shared.item()

    def on_first(self, work: Callable[[], Value]) -> Value:
        """Do something in the first process alone; all get its answer, or its error."""
        if self.size == 1:
            return work()
        answer: list[Any] = [None, None]
        error: IkgradError | None = None
        if self.first:
            try:
                answer[0] = work()
            except IkgradError as raised:
                error, answer[1] = raised, str(raised)
        dist.broadcast_object_list(answer, src=0)
        if error is not None:
            raise error
        if answer[1] is not None:
            raise DataError(answer[1])
        return answer[0]


@contextmanager
def processes_of_torchrun() -> Iterator[Processes]:
    """The processes that ``torchrun`` started, joined for as long as the block lasts; alone without it."""
    if dist.is_available() and dist.is_initialized():
        yield Processes(dist.get_rank(), dist.get_world_size())
        return
    if world_size() == 1:
        yield Processes()
        return
    dist.init_process_group(_BACKENDS if torch.cuda.is_available() else "gloo")
    try:
        yield Processes(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()


def world_size() -> int:
    """How many processes the environment says there are."""
    return int(os.environ.get("WORLD_SIZE", "1")) if "RANK" in os.environ else 1


__all__ = ["Processes", "processes_of_torchrun", "world_size"]
