"""Processes that share one training: each learns from its rows of every batch, and all take the same steps.

Gradients are added up by one explicit all-reduce a step. ``DistributedDataParallel`` would add nothing: it wraps one
call of one module, while a training calls its network once a round with the chain in between, and hides the time of
messages behind that of layers, of which small networks have none to speak of.
"""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch import distributed as dist

from ikgrad.errors import ConfigError, DataError, IkgradError

_BACKENDS = "cpu:gloo,cuda:nccl"
_PAUSE = 0.02  # seconds between two looks for the others
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
            with _told():
                dist.all_reduce(numbers)
        return numbers

    def from_first(self, value: float) -> float:
        """The first process's value: what all decide by."""
        if self.size == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64)
        with _told():
            dist.broadcast(shared, src=0)
        return shared.item()

    def least(self, value: float) -> float:
        """The smallest value of all processes."""
        if self.size == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64)
        with _told():
            dist.all_reduce(shared, op=dist.ReduceOp.MIN)
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
        with _told():
            dist.broadcast_object_list(answer, src=0)
        if error is not None:
            raise error
        if answer[1] is not None:
            raise DataError(answer[1])
        return answer[0]


@contextmanager
def _told() -> Iterator[None]:
    """A message that does not come through means that another process is gone: one line instead of a trace."""
    try:
        yield
    except RuntimeError as error:
        raise IkgradError(
            "another process of this training has ended or cannot be reached; torchrun --max-restarts goes on from the "
            "last checkpoint"
        ) from error


@contextmanager
def processes_of_torchrun() -> Iterator[Processes]:
    """The processes that ``torchrun`` started, joined for as long as the block lasts; alone without it."""
    if dist.is_available() and dist.is_initialized():
        yield Processes(dist.get_rank(), dist.get_world_size())
        return
    if world_size() == 1:
        yield Processes()
        return
    store, rank, size = next(iter(dist.rendezvous("env://")))
    own = dist.PrefixStore(meet(store, rank, size), store)
    backends = _BACKENDS if torch.cuda.is_available() else "gloo"
    dist.init_process_group(backends, store=own, rank=rank, world_size=size)
    try:
        yield Processes(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()


def meet(store: Any, rank: int, size: int, *, patience: float = 600.0) -> str:
    """Agree on a name that no other start of this job has had.

    The store lives in torchrun and keeps what killed processes have written into it, addresses among other things;
    whoever reads those waits for ever. So all processes that live tell the first one a word of their own, and it
    answers each word with its own one, until it has heard of all that they have read it.

    Args:
        store: of torchrun.
        rank: of this process.
        size: how many there are.
        patience: seconds to wait for the others.

    Raises:
        IkgradError: the others did not come.
    """
    word, end = uuid.uuid4().hex, time.monotonic() + patience
    if rank > 0:
        store.set(f"ikgrad/here/{rank}", word)
        store.wait([f"ikgrad/answer/{word}"], timedelta(seconds=patience))
        name: str = store.get(f"ikgrad/answer/{word}").decode()
        store.set(f"ikgrad/read/{name}/{rank}", "1")
        return name
    missing = set(range(1, size))
    while missing:
        for other in sorted(missing):
            if store.check([f"ikgrad/here/{other}"]):
                store.set(f"ikgrad/answer/{store.get(f'ikgrad/here/{other}').decode()}", word)
            if store.check([f"ikgrad/read/{word}/{other}"]):
                missing.discard(other)
        if time.monotonic() > end:
            raise IkgradError(f"{len(missing)} of {size} processes did not come within {patience:g} s")
        time.sleep(_PAUSE if missing else 0.0)
    return word


def world_size() -> int:
    """How many processes the environment says there are."""
    return int(os.environ.get("WORLD_SIZE", "1")) if "RANK" in os.environ else 1


__all__ = ["Processes", "processes_of_torchrun", "world_size"]
