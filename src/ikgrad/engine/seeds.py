"""First guesses: configurations of the robot sorted by where they put the last joint's axis.

Turning the first joint carries the whole arm about a fixed axis, and turning the last joint leaves its own axis where
it is. So of a pose's six numbers only four say how the joints between must stand: with the last joint's frame (p, R)
in cylinder coordinates about the first axis, the radius and height of p, and the direction z of R in the half-plane
of p. Random configurations are sorted into cells of these four numbers once a robot; a target looks into its own
cell, takes the nearest configuration, and reads the first and last joint off exactly.

Where the first or last joint slides or is a mimic joint the same cells give rougher guesses.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.simd import (
    NO_LANES,
    W,
    floor,
    get_lane,
    load,
    load_single,
    lowest,
    mask_of,
    select,
    set_lane,
    sqrt,
    store,
)
from ikgrad.engine.vecmath import atan2_roughly, cross

if TYPE_CHECKING:
    from ikgrad.engine.tables import PackedChain

SAMPLES = 1 << 16
_BINS = (8, 8, 6, 6, 2)  # radius, height, and z: outwards, sideways, up or down
_FAR_AWAY = 1e6  # features of an empty slot
_TOO_FAR = 100.0  # score above which a slot is taken to be empty
FEATURES = 5  # radius, height, z outwards, z sideways, z upwards


class Seeds(NamedTuple):
    """Configurations by cell, as flat arrays; a block holds up to eight of one cell."""

    grid: NDArray[np.float64]  # (7,) lowest radius and height, bins a metre (two), length, 1 if the first, last turns
    blocks: NDArray[np.int32]  # (cells,) block of a cell, -1 if no configuration fell into it
    features: NDArray[np.float32]  # (blocks * FEATURES * 8,) eight configurations side by side
    records: NDArray[np.float32]  # (blocks * 8 * (n + 3),) x of the last frame in the half-plane, then q


def build(chain: PackedChain) -> Seeds:
    """Draw and sort the configurations of a robot: a fraction of a second, always the same ones."""
    from ikgrad.engine.kinematics import fk

    n, m = len(chain.low), len(chain.kinds) // 2
    variable, slides = chain.kinds[1::2], chain.kinds[::2] != 0
    single = [not slides[k] and (variable == variable[k]).sum() == 1 for k in (0, m - 1)]
    first, last = single[0] and m > 1, single[1]
    unit = np.random.default_rng(0).random((SAMPLES, n))
    q = chain.low + unit * (chain.high - chain.low)
    for k, turns in ((0, first), (m - 1, last)):
        if turns:
            q[:, variable[k]] = -chain.joints[9 * k + 6] / chain.joints[9 * k + 5]  # the joint's frame unturned
    identity = np.array([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0])
    T = fk(replace(chain, base=identity, tool=identity), q)
    radius = np.hypot(T[:, 0, 3], T[:, 1, 3])
    safe = np.where(radius > 0, radius, 1.0)
    c, s = np.where(radius > 0, T[:, 0, 3], 1.0) / safe, T[:, 1, 3] / safe
    z, x, height = T[:, :3, 2], T[:, :3, 0], T[:, 2, 3]
    out = [np.stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]], axis=1) for v in (z, x)]
    if first:
        q[:, variable[0]] = -np.arctan2(s, c)
    features = np.column_stack([radius, height, out[0]])
    low = features[:, :2].min(axis=0)
    span = np.maximum(features[:, :2].max(axis=0) - low, 1e-9 * chain.length)
    scale = np.array(_BINS[:2]) / span
    grid = np.array([*low, *scale, chain.length, first, last])
    return _sort(grid, features, np.concatenate([out[1], q], axis=1))


def _sort(grid: np.ndarray, features: np.ndarray, records: np.ndarray) -> Seeds:
    """Fill the blocks: the first eight configurations of every cell, in the order they were drawn."""
    cell = _cells(features, grid)
    order = np.argsort(cell, kind="stable")
    count = np.bincount(cell, minlength=math.prod(_BINS))
    slot = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)  # place among those of its cell
    used = np.flatnonzero(count)
    blocks = np.full(len(count), -1, dtype=np.int32)
    blocks[used] = np.arange(len(used))
    kept = order[slot < W]
    block, slot = blocks[cell[kept]], slot[slot < W]
    side_by_side = np.full((len(used), FEATURES, W), _FAR_AWAY, dtype=np.float32)
    side_by_side[block, :, slot] = features[kept]
    by_slot = np.zeros((len(used), W, records.shape[1]), dtype=np.float32)
    by_slot[block, slot] = records[kept]
    return Seeds(grid, blocks, side_by_side.reshape(-1), by_slot.reshape(-1))


def _cells(features: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Cell of each row of features; the kernel's `cell_of` for many."""
    a = np.clip((features[:, 0] - grid[0]) * grid[2], 0, _BINS[0] - 1).astype(np.int64)
    b = np.clip((features[:, 1] - grid[1]) * grid[3], 0, _BINS[1] - 1).astype(np.int64)
    c = np.clip((features[:, 2] + 1.0) * (_BINS[2] / 2), 0, _BINS[2] - 1).astype(np.int64)
    d = np.clip((features[:, 3] + 1.0) * (_BINS[3] / 2), 0, _BINS[3] - 1).astype(np.int64)
    return (((a * _BINS[1] + b) * _BINS[2] + c) * _BINS[3] + d) * _BINS[4] + (features[:, 4] > 0)


@njit(forceinline=True)
def _bin(value: Any, bins: float) -> Any:
    value = select(value > 0.0, value, 0.0)  # also of a NaN
    return floor(select(value < bins - 1.0, value, bins - 1.0))


@njit(forceinline=True)
def _cells_of(radius: Any, height: Any, zr: Any, zt: Any, zh: Any, grid: Any) -> Any:
    """Cells of eight targets, as floats; the same as `_cells`."""
    a = _bin((radius - grid[0]) * grid[2], float(_BINS[0]))
    b = _bin((height - grid[1]) * grid[3], float(_BINS[1]))
    c = _bin((zr + 1.0) * (_BINS[2] / 2), float(_BINS[2]))
    d = _bin((zt + 1.0) * (_BINS[3] / 2), float(_BINS[3]))
    up = select(zh > 0.0, 1.0, 0.0)
    return (((a * float(_BINS[1]) + b) * float(_BINS[2]) + c) * float(_BINS[3]) + d) * float(_BINS[4]) + up


@njit(forceinline=True)
def _turn_to(theta: Any, multiplier: float, offset: float, low: float, high: float) -> Any:
    """Q in low..high with theta = multiplier q + offset modulo full turns; the nearer end if there is none."""
    a, b = multiplier * low + offset, multiplier * high + offset
    a, b = min(a, b), max(a, b)
    turn = 2.0 * math.pi
    theta = theta - turn * floor((theta - a) * (1.0 / turn))  # the first one at or above a
    theta = select(theta > b, select(theta - b < a + turn - theta, b, a), theta)
    q = (theta - offset) / multiplier
    return select(q > high, high, select(q < low, low, q))


@njit(forceinline=True)
def _pick(block: int, features: Any, target: Any, rank: int, weight: float) -> int:
    """The configuration of this rank (0 the nearest) among a block's eight, -1 if it holds no more."""
    at = block * FEATURES * W
    dr, dh = load_single(features, at) - target[0], load_single(features, at + W) - target[1]
    dx, dy = load_single(features, at + 2 * W) - target[2], load_single(features, at + 3 * W) - target[3]
    dz = load_single(features, at + 4 * W) - target[4]
    score = (dr * dr + dh * dh) * weight + dx * dx + dy * dy + dz * dz
    best = lowest(score)
    while rank > 0 and best < W:
        score = set_lane(score, best, math.inf)
        best = lowest(score)
        rank -= 1
    return best if best < W and get_lane(score, best) < _TOO_FAR else -1


@njit(forceinline=True)
def guess_lanes(
    pose: Any, wanted: int, ranks: Any, jitter: Any, grid: Any, blocks: Any, features: Any, records: Any,
    joints: Any, kinds: Any, low: Any, high: Any, q: Any, scratch: Any,
) -> int:  # fmt: skip
    """Put configurations near eight targets into lanes.

    Args:
        pose: 12 Vecs, columns x, y, z, p of the last joint's frame as the first joint's frame sees it [m].
        wanted: the lanes to fill, by bits.
        ranks: (8,) int64, how many nearer configurations to skip.
        jitter: (5 * 8,) added to the numbers that choose the cell, in bins.
        grid: like the next three a field of `Seeds`.
        blocks: the block of each cell.
        features: what to compare.
        records: what to take.
        joints: like the next three a field of `PackedChain`.
        kinds: for the first and last joint's column.
        low: lower ends of the ranges.
        high: upper ends.
        q: (n * 8,) receives the guesses.
        scratch: (9 * 8,)

    Returns:
        The lanes filled, by bits; a cell may be empty.
    """
    n, m = low.size, kinds.size // 2
    xx, xy, xz, _, _, _, zx, zy, zz, px, py, height = pose
    radius = sqrt(px * px + py * py)
    away = radius > 0.0
    inverse = 1.0 / select(away, radius, 1.0)
    c, s = select(away, px * inverse, 1.0), select(away, py * inverse, 0.0)
    zr, zt = c * zx + s * zy, c * zy - s * zx
    store(scratch, 0, radius)
    store(scratch, W, height)
    store(scratch, 2 * W, zr)
    store(scratch, 3 * W, zt)
    store(scratch, 4 * W, zz)
    cells = _cells_of(
        radius + load(jitter, 0) / grid[2],
        height + load(jitter, W) / grid[3],
        zr + load(jitter, 2 * W) * (2.0 / _BINS[2]),
        zt + load(jitter, 3 * W) * (2.0 / _BINS[3]),
        zz + load(jitter, 4 * W),
        grid,
    )
    store(scratch, 5 * W, cells)
    weight, found = 1.0 / (grid[4] * grid[4]), NO_LANES
    for lane in range(W):  # independent lanes, so that their cache misses overlap
        if not (wanted >> lane) & 1:
            continue
        block = blocks[int(scratch[5 * W + lane])]
        if block < 0:
            continue
        radius_i, height_i = scratch[lane], scratch[W + lane]
        direction = scratch[2 * W + lane], scratch[3 * W + lane], scratch[4 * W + lane]
        best = _pick(block, features, (radius_i, height_i, *direction), ranks[lane], weight)
        if best < 0:
            continue
        found |= 1 << lane
        at = (block * W + best) * (n + 3)
        for i in range(3):
            scratch[(6 + i) * W + lane] = records[at + i]
        for j in range(n):
            q[j * W + lane] = min(max(float(records[at + 3 + j]), low[j]), high[j])
    filled = mask_of(found)
    if grid[5] != 0.0:
        j = kinds[1]
        old = load(q, j * W)
        theta = atan2_roughly(py, px) + old
        store(q, j * W, select(filled, _turn_to(theta, joints[5], joints[6], low[j], high[j]), old))
    if grid[6] != 0.0:
        j = kinds[2 * m - 1]
        xr, xt = c * xx + s * xy, c * xy - s * xx
        ar, at_, ah = load(scratch, 6 * W), load(scratch, 7 * W), load(scratch, 8 * W)
        br, bt, bh = cross(zr, zt, zz, ar, at_, ah)
        theta = atan2_roughly(br * xr + bt * xt + bh * xz, ar * xr + at_ * xt + ah * xz)
        turned = _turn_to(theta, joints[9 * m - 4], joints[9 * m - 3], low[j], high[j])
        store(q, j * W, select(filled, turned, load(q, j * W)))
    return found
