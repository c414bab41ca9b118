"""Where a row begins: its target and the joint values of its next start, put into lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ikgrad.engine.chain import gather_rows
from ikgrad.engine.randoms import mix, mix_floats, unit
from ikgrad.engine.seeds import FEATURES, guess_lanes
from ikgrad.engine.simd import NO_LANES, W, bits, fabs, load, select, splat, store

_HUGE = 1e150  # a target with larger numbers cannot be squared
_JITTER = 2.0  # bins, see `restart`


@njit(forceinline=True)
def load_targets(T: Any, row: int, tool: Any, length: float, lanes: Any, target: Any) -> int:
    """Eight targets into lanes: the columns of R* R_tool^T and p* / length. Returns the finite ones, by bits.

    The tool's rotation is the target's business, so that the steps need not turn by it.
    """
    gather_rows(T, row, 16, lanes)
    total = splat(0.0)
    for i in range(12):
        total = total + fabs(load(lanes, i * W))
    for i in range(3):
        a, b, c = load(lanes, 4 * i * W), load(lanes, (4 * i + 1) * W), load(lanes, (4 * i + 2) * W)
        for j in range(3):
            store(target, (3 * j + i) * W, a * tool[j] + b * tool[3 + j] + c * tool[6 + j])
        store(target, (9 + i) * W, load(lanes, (4 * i + 3) * W) / length)
    return bits(total < _HUGE)


@njit(forceinline=True)
def load_starts(q0: Any, row: int, limits: bool, q_min: Any, q_max: Any, q: Any) -> int:
    """Eight first starts into lanes, inside the limits. Returns the finite ones, by bits."""
    gather_rows(q0, row, q_min.size, q)
    total = splat(0.0)
    for j in range(q_min.size):
        value = load(q, j * W)
        total = total + fabs(value)
        if limits:
            value = select(value > q_max[j], q_max[j], select(value < q_min[j], q_min[j], value))
        store(q, j * W, value)
    return bits(total < _HUGE)


@njit(forceinline=True)
def _last_frames(target: Any, base: Any, tool: Any, length: float) -> Any:
    """Where the last joint's frames must be as the first joint's frame sees them [m], 12 Vecs."""
    x = load(target, 0), load(target, W), load(target, 2 * W)
    y = load(target, 3 * W), load(target, 4 * W), load(target, 5 * W)
    z = load(target, 6 * W), load(target, 7 * W), load(target, 8 * W)
    px = load(target, 9 * W) - x[0] * tool[9] - y[0] * tool[10] - z[0] * tool[11] - base[9]
    py = load(target, 10 * W) - x[1] * tool[9] - y[1] * tool[10] - z[1] * tool[11] - base[10]
    pz = load(target, 11 * W) - x[2] * tool[9] - y[2] * tool[10] - z[2] * tool[11] - base[11]
    p = px * length, py * length, pz * length
    return (*_seen(base, x), *_seen(base, y), *_seen(base, z), *_seen(base, p))


@njit(forceinline=True)
def _seen(base: Any, v: Any) -> Any:
    """R_base^T v."""
    return (
        v[0] * base[0] + v[1] * base[1] + v[2] * base[2],
        v[0] * base[3] + v[1] * base[4] + v[2] * base[5],
        v[0] * base[6] + v[1] * base[7] + v[2] * base[8],
    )


@njit
def next_starts(
    T: Any, q0: Any, rows: Any, starts: Any, wanted: int, guesses: int, seed: int, base: Any, joints: Any,
    kinds: Any, tool: Any, low: Any, high: Any, length: float, grid: Any, blocks: Any, features: Any,
    records: Any, target: Any, q: Any, ranks: Any, jitter: Any, scratch: Any,
) -> None:  # fmt: skip
    """Joint values for the wanted lanes: the nearest configurations in the target's cell, one after the other.

    When they are used up, three starts of four look into a cell somewhat beside the target's, which often holds
    another branch of solutions, and one is random.

    Args:
        T: (B * 16,) targets, part of the key of the random numbers.
        q0: (B * n,) first starts, another part; or empty.
        rows: (8,) the rows that the lanes work on.
        starts: (8,) the starts that they have used.
        wanted: the lanes to fill, by bits.
        guesses: how many configurations to take from the target's own cell.
        seed: part of the key.
        base: like the next six a field of `PackedChain`, lengths divided by ``length``.
        joints: see there.
        kinds: see there.
        tool: see there.
        low: see there.
        high: see there.
        length: the arm's typical length [m].
        grid: like the next three a field of `Seeds`.
        blocks: see there.
        features: see there.
        records: see there.
        target: (12 * 8,) from `load_targets`.
        q: (n * 8,) receives the starts.
        ranks: (8,) int64 scratch.
        jitter: (5 * 8,) scratch.
        scratch: (9 * 8,) scratch.
    """
    n = low.size
    from_cells = NO_LANES
    for lane in range(W):
        ranks[lane] = max(starts[lane] - (1 if q0.size > 0 else 0), 0)
        for i in range(FEATURES):
            jitter[i * W + lane] = 0.0
        if not (wanted >> lane) & 1:
            continue
        if starts[lane] < guesses:
            from_cells |= 1 << lane
        elif guesses > 0 and starts[lane] % 4 != 3:
            from_cells |= 1 << lane
            ranks[lane] = 0
            key = _key(T, q0, rows[lane], starts[lane], seed, n)
            for i in range(FEATURES):
                jitter[i * W + lane] = _JITTER * (2.0 * unit(mix(key, np.uint64(i))) - 1.0)
    found = NO_LANES
    if from_cells != 0:
        pose = _last_frames(target, base, tool, length)
        found = guess_lanes(
            pose, from_cells, ranks, jitter, grid, blocks, features, records, joints, kinds, low, high, q, scratch
        )  # fmt: skip
    missing = wanted & ~found
    if missing != 0:
        _random_lanes(T, q0, rows, starts, missing, seed, low, high, q)


@njit
def _random_lanes(T: Any, q0: Any, rows: Any, starts: Any, wanted: int, seed: int, low: Any, high: Any, q: Any) -> None:
    """Uniformly random joint values for the wanted lanes."""
    n = low.size
    for lane in range(W):
        if (wanted >> lane) & 1:
            key = _key(T, q0, rows[lane], starts[lane], seed, n)
            for j in range(n):
                value = low[j] + unit(mix(key, np.uint64(j))) * (high[j] - low[j])
                q[j * W + lane] = min(max(value, low[j]), high[j])


@njit
def _key(T: Any, q0: Any, row: int, start: int, seed: int, n: int) -> Any:
    """Key of the random numbers of one start: the seed, the row's content and the number of the start."""
    word = np.empty(1)
    key = mix_floats(np.uint64(seed), T, 16 * row, 16 * row + 12, word)
    if q0.size > 0:
        key = mix_floats(key, q0, row * n, row * n + n, word)
    return mix(key, np.uint64(start))
