"""Points on the links: positions in the base, and their vector-Jacobian product, eight rows at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.chain import (
    WALK,
    aligned,
    first_frame,
    gather_rows,
    leave_joint,
    padded,
    rotate,
    scatter_rows,
    through_joint,
    to_joint,
)  # fmt: skip
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.simd import W, load, splat, store
from ikgrad.engine.tables import PackedChain
from ikgrad.engine.vecmath import cross

Array = NDArray[np.float64]
_CHUNK = 1024  # rows; a multiple of the lanes


@dataclass(frozen=True, eq=False)
class PackedPoints:
    """Points that ride on a chain, in the order of the frames that carry them."""

    frame: NDArray[np.int64]  # (P,) moving frame, 1 ... m; 0 is the base
    offset: Array  # (P * 3,) the point in that frame (in the base for frame 0)


@njit(forceinline=True)
def _points_block(
    base: Any, joints: Any, kinds: Any, lanes: Any, frames: Any, carried_by: Any, offset: Any, out: Any
) -> None:
    """Positions in lanes: coordinate c of point i at (3 i + c) * W; z and p of the joints into ``frames``."""
    i, count = 0, carried_by.size
    while i < count and carried_by[i] == 0:
        for c in range(3):
            store(out, (3 * i + c) * W, splat(offset[3 * i + c]))
        i += 1
    frame = first_frame(base)
    for k in range(kinds.size // 2):
        if k > 0:
            frame = to_joint(frame, joints, k)
        leave_joint(frame, k, frames)
        frame = through_joint(frame, joints, kinds, lanes, k)
        while i < count and carried_by[i] == k + 1:
            d = rotate(frame, offset[3 * i], offset[3 * i + 1], offset[3 * i + 2])
            store(out, 3 * i * W, frame[9] + d[0])
            store(out, (3 * i + 1) * W, frame[10] + d[1])
            store(out, (3 * i + 2) * W, frame[11] + d[2])
            i += 1


@kernel
def points_rows(
    base: Any, joints: Any, kinds: Any, carried_by: Any, offset: Any, q: Any, points: Any, first: int, last: int, n: int
) -> None:
    """Points (B, P, 3) of rows first..last of q (B, n), all flat; ``first`` is a multiple of 8."""
    size = 3 * carried_by.size
    lanes, frames, out = aligned(n * W), aligned(kinds.size // 2 * WALK), aligned(size * W)
    row = first
    while row < last:
        whole = row + W <= last
        gather_rows(q if whole else padded(q, row, last, n), row if whole else 0, n, lanes)
        _points_block(base, joints, kinds, lanes, frames, carried_by, offset, out)
        if whole:
            scatter_rows(out, points, row, size)
        else:
            rest = np.empty(W * size)
            scatter_rows(out, rest, 0, size)
            for i in range((last - row) * size):
                points[row * size + i] = rest[i]
        row += W


@njit(forceinline=True)
def _pull_block(joints: Any, kinds: Any, frames: Any, carried_by: Any, points: Any, g: Any, n: int, out: Any) -> None:
    """Gradient in lanes from the tip to the base: force and torque of all points beyond a joint, on its axis."""
    for j in range(n):
        store(out, j * W, splat(0.0))
    fx, fy, fz, tx, ty, tz = splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    i = carried_by.size - 1
    for k in range(kinds.size // 2 - 1, -1, -1):
        while i >= 0 and carried_by[i] > k:
            gx, gy, gz = load(g, 3 * i * W), load(g, (3 * i + 1) * W), load(g, (3 * i + 2) * W)
            px, py, pz = load(points, 3 * i * W), load(points, (3 * i + 1) * W), load(points, (3 * i + 2) * W)
            ax, ay, az = cross(px, py, pz, gx, gy, gz)
            fx, fy, fz, tx, ty, tz = fx + gx, fy + gy, fz + gz, tx + ax, ty + ay, tz + az
            i -= 1
        j, at = k * WALK, kinds[2 * k + 1] * W
        zx, zy, zz = load(frames, j), load(frames, j + W), load(frames, j + 2 * W)
        if kinds[2 * k] != 0:
            slope = zx * fx + zy * fy + zz * fz
        else:
            ox, oy, oz = load(frames, j + 3 * W), load(frames, j + 4 * W), load(frames, j + 5 * W)
            mx, my, mz = cross(ox, oy, oz, fx, fy, fz)
            slope = zx * (tx - mx) + zy * (ty - my) + zz * (tz - mz)
        store(out, at, load(out, at) + slope * joints[9 * k + 5])


@kernel
def points_vjp_rows(
    base: Any, joints: Any, kinds: Any, carried_by: Any, offset: Any,
    q: Any, g: Any, grad: Any, first: int, last: int, n: int,
) -> None:  # fmt: skip
    """Gradients (B, n) from dL/dpoints g (B, P, 3) of rows first..last of q (B, n), all flat."""
    size = 3 * carried_by.size
    lanes, frames, out = aligned(n * W), aligned(kinds.size // 2 * WALK), aligned(size * W)
    g_lanes, grad_lanes = aligned(size * W), aligned(n * W)
    row = first
    while row < last:
        whole = row + W <= last
        at = row if whole else 0
        gather_rows(q if whole else padded(q, row, last, n), at, n, lanes)
        gather_rows(g if whole else padded(g, row, last, size), at, size, g_lanes)
        _points_block(base, joints, kinds, lanes, frames, carried_by, offset, out)
        _pull_block(joints, kinds, frames, carried_by, out, g_lanes, n, grad_lanes)
        if whole:
            scatter_rows(grad_lanes, grad, row, n)
        else:
            rest = np.empty(W * n)
            scatter_rows(grad_lanes, rest, 0, n)
            for i in range((last - row) * n):
                grad[row * n + i] = rest[i]
        row += W


def _flat(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64).reshape(-1)


def points(chain: PackedChain, carried: PackedPoints, q: Array, *, threads: int = 1) -> Array:
    """Positions of points on the links in the base.

    Args:
        chain: from `pack`.
        carried: the points, from `pack_points`.
        q: (B, n) joint values [rad or m].
        threads: threads to use.

    Returns:
        (B, P, 3)
    """
    rows, n = q.shape
    where = np.empty((rows, len(carried.frame), 3))
    flat, out, run = _flat(q), where.reshape(-1), prepare(points_rows)
    base, joints, kinds, frame, offset = chain.base, chain.joints, chain.kinds, carried.frame, carried.offset
    for_chunks(lambda a, b: run(base, joints, kinds, frame, offset, flat, out, a, b, n), rows, _CHUNK, threads)
    return where


def points_vjp(chain: PackedChain, carried: PackedPoints, q: Array, grad_points: Array, *, threads: int = 1) -> Array:
    """Gradient of a loss with respect to q from its gradient with respect to the `points`, in one pass.

    Args:
        chain: from `pack`.
        carried: the points.
        q: (B, n) joint values [rad or m].
        grad_points: (B, P, 3) dL/dpoints.
        threads: threads to use.

    Returns:
        (B, n)
    """
    rows, n = q.shape
    grad = np.empty((rows, n))
    flat, g, out, run = _flat(q), _flat(grad_points), grad.reshape(-1), prepare(points_vjp_rows)
    base, joints, kinds, frame, offset = chain.base, chain.joints, chain.kinds, carried.frame, carried.offset
    for_chunks(lambda a, b: run(base, joints, kinds, frame, offset, flat, g, out, a, b, n), rows, _CHUNK, threads)
    return grad


def pack_points(chain: PackedChain, frame: NDArray[np.int64], at_zero: Array) -> PackedPoints:
    """Points from the frames that carry them and their positions in the base at q = 0.

    The kernels turn frames about their axes (see `PackedChain`), so a point's place in them is read off by the
    kernel itself: from where it puts the origin and the unit points of every frame.

    Args:
        chain: from `pack`.
        frame: (P,) moving frame of each point, not decreasing; 0 is the base.
        at_zero: (P, 3) positions at q = 0.
    """
    count = len(chain.kinds) // 2
    unit = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    probes = PackedPoints(np.repeat(np.arange(1, count + 1), 4), np.tile(unit, (count, 1)).reshape(-1))
    seen = points(chain, probes, np.zeros((1, len(chain.q_min)))).reshape(count, 4, 3)
    offset = at_zero.copy()
    for i in np.flatnonzero(frame):
        origin, axes = seen[frame[i] - 1, 0], seen[frame[i] - 1, 1:] - seen[frame[i] - 1, 0]
        offset[i] = axes @ (at_zero[i] - origin)
    return PackedPoints(frame.astype(np.int64), offset.reshape(-1))
