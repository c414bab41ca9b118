"""How much memory a training will take, asked before anything is allocated."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from ikgrad.errors import ConfigError

_COPIES = 6  # of the weights: weights, gradient, best, the inverters' own, two of the optimizer
_STREAM_COPIES = 9  # as _COPIES, and what Muon makes of the square ones
_ROW_COPIES = 8  # of what is known of a row of a stream: draws, joints, poses, errors, steps
_MEMBER = 2_000_000  # bytes of the rows that an inverter is judged on
_MATRICES = 3  # of Levenberg-Marquardt: J^T J, its factor, and what a product needs
_PIECE = 16_000_000 * 8  # bytes of a piece of J, see `ikgrad.optim.layer_blocks`
_STEP, _LOOK = 3, 2  # of all activations: for a batch, forward and backward; for all rows, to take the errors
GIB = 2**30


def check_memory(
    sizes: Sequence[int],
    *,
    rows: int,
    batch_size: int | None,
    members: int,
    item: int,
    optimizer: str,
    available: int | None,
) -> dict[str, int]:
    """Refuse a training that cannot fit.

    Args:
        sizes: units of each layer, inputs first.
        rows: of a data set.
        batch_size: rows a step; None: all.
        members: networks that learn side by side, each on rows of its own.
        item: bytes of a number.
        optimizer: its name.
        available: bytes; None: unknown, nothing is refused.

    Returns:
        What is taken by what [bytes].

    Raises:
        ConfigError: more than is available; the message names the largest part, the estimate and the memory there is.

    Example:
        >>> need = check_memory((6, 10, 6), rows=4000, batch_size=None, members=1, item=8,
        ...                     optimizer="levenberg_marquardt", available=None)
        >>> list(need)
        ['136 weights', '4,000 rows of data', 'activations of 4,000 rows', 'J^T J of 136 weights']
    """
    weights = sum((a + 1) * b for a, b in pairwise(sizes))
    batch = min(batch_size or rows, rows)
    need = {
        f"{weights:,} weights": _COPIES * weights * members * item,
        f"{rows:,} rows of data": rows * members * 4 * 8 * (16 + sizes[0] + sizes[-1]),
        f"activations of {rows:,} rows": max(_STEP * batch, _LOOK * rows) * sum(sizes) * members * item,
    }
    if optimizer == "levenberg_marquardt":
        piece = min(_PIECE, batch * sizes[-1] * weights * members * item)
        need[f"J^T J of {weights:,} weights"] = _MATRICES * weights**2 * members * item + piece
    _refuse("-".join(map(str, sizes)) + (f", {members} members" if members > 1 else ""), need, available)
    return need


def check_stream_memory(
    inputs: int, outputs: int, *, width: int, depth: int, rounds: int, batch_size: int, looked_at: int,
    members: int, available: int | None,
) -> dict[str, int]:  # fmt: skip
    """The same for inverters that learn from a stream.

    Args:
        inputs: of the network.
        outputs: of the network.
        width: units of each hidden layer.
        depth: hidden layers.
        rounds: in which the network is asked; all their activations are kept until the gradient is known.
        batch_size: rows a step.
        looked_at: rows that are answered at once to measure errors.
        members: inverters, of which one learns at a time.
        available: bytes; None: unknown, nothing is refused.

    Returns:
        What is taken by what [bytes].

    Raises:
        ConfigError: more than is available.
    """
    weights = (inputs + 1) * width + (depth - 1) * (width + 1) * width + (width + 1) * outputs
    units = inputs + depth * width + outputs
    need = {
        f"{weights:,} weights": _STREAM_COPIES * weights * members * 4,
        f"{batch_size:,} rows of data": batch_size * 8 * _ROW_COPIES * (16 + 3 * outputs),
        f"activations of {batch_size:,} rows": _STEP * rounds * batch_size * units * 4,
        f"activations of {looked_at:,} rows": 3 * looked_at * max(width, inputs) * 4,
        f"{members:,} members": members * _MEMBER,
    }
    _refuse(f"{inputs}-{depth} x {width}-{outputs}", need, available)
    return need


def _refuse(network: str, need: dict[str, int], available: int | None) -> None:
    total = sum(need.values())
    if available is None or total <= available:
        return
    largest = max(need, key=lambda part: need[part])
    advice = "fewer rows" if largest.endswith("data") else "fewer hidden units"
    advice = "fewer members" if largest.endswith("members") else advice
    advice += " or rows" if largest.startswith("activations") else ""
    advice += ", or another optimizer such as Adam" if largest.startswith("J^T J") else ""
    raise ConfigError(
        f"the training of {network} needs about {_size(total)}, most of it for {largest}, but there are "
        f"{_size(available)} of memory; try {advice}"
    )


def available_memory(device: str = "cpu") -> int | None:
    """Bytes that can still be allocated, limits of the container included; None where the system does not say."""
    if device != "cpu":
        import torch

        return torch.cuda.mem_get_info(torch.device(device))[0]
    limits = [_free(), _container("memory.max", "memory.current")]
    return min((limit for limit in limits if limit is not None), default=None)


def _free() -> int | None:
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
        return int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        pass
    try:  # macOS and others: what is installed
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):
        return None


def _container(limit: str, used: str, folder: Path = Path("/sys/fs/cgroup")) -> int | None:
    try:
        return int((folder / limit).read_text()) - int((folder / used).read_text())
    except (OSError, ValueError):  # no such file; or "max"
        return None


def _size(count: int) -> str:
    return f"{count / GIB:,.1f} GiB" if count >= GIB / 10 else f"{count / 2**20:,.1f} MiB"


__all__ = ["available_memory", "check_memory", "check_stream_memory"]
