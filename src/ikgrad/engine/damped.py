"""A fixed number of damped steps for all rows alike: what a network holds of the chain, and what it is compared with.

The step is that of `ikgrad.engine.solver` (active set, step limit, joint limits), without restarts and without the
turn away from the limits; rows do not wait for each other's convergence because nobody waits for any.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.chain import WALK, aligned, padded, scatter_rows, tip_position, walk
from ikgrad.engine.linear import add_outer, solve6
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.simd import W, load, load_column, select, splat, store
from ikgrad.engine.solver import _columns, _rotation_error, _unit_chain
from ikgrad.engine.starts import load_starts, load_targets
from ikgrad.engine.tables import PackedChain

Array = NDArray[np.float64]
_CHUNK = 1024
_ALL = (1 << W) - 1


class Damped(NamedTuple):
    """Where the rows stand after the steps, and the way ahead. Lengths in errors are divided by ``chain.length``."""

    q: Array  # (B, n) inside the limits
    error: Array  # (B, 6) [R^T (p* - p) / length; R^T log(R* R^T)], seen from the tip
    step: Array  # (B, n) the next step, cut at the limits [rad or m]
    slope: Array  # (B, 2, n) J^T e of the position and of the rotation: half the fall of |e|^2 along each joint


def damped(
    chain: PackedChain,
    T: Array,
    q: Array,
    *,
    steps: int = 0,
    damping: float | Array = 0.01,
    max_step: float = 0.8,
    threads: int = 1,
) -> Damped:
    """Take some damped steps towards targets, and look at the next one.

    Args:
        chain: from `pack`.
        T: (B, 4, 4) targets; a row with numbers that are not finite gives NaN.
        q: (B, n) where to start; clamped to the limits.
        steps: how many to take before looking; 0: none.
        damping: mu = damping |e|^2 + 1e-12; one number, or (B,) one a row.
        max_step: largest change of a joint in a step [rad], for slides times the arm's typical length.
        threads: threads to use.
    """
    rows, n = q.shape
    mu = np.broadcast_to(np.asarray(damping, dtype=np.float64), (rows,))
    flat, first = np.ascontiguousarray(T, dtype=np.float64).reshape(-1), np.ascontiguousarray(q, dtype=np.float64)
    out, error, step, slope = np.empty((rows, n)), np.empty((rows, 6)), np.empty((rows, n)), np.empty((rows, 2, n))
    arrays = (
        chain.base, chain.joints, chain.kinds, chain.tool, chain.q_min, chain.q_max, chain.slide, chain.length, flat,
        first.reshape(-1), np.ascontiguousarray(mu), steps, max_step,
        out.reshape(-1), error.reshape(-1), step.reshape(-1), slope.reshape(-1),
    )  # fmt: skip
    run = prepare(damped_rows)
    for_chunks(lambda a, b: run(*arrays, a, b), rows, _CHUNK, threads)
    return Damped(out, error, step, slope)


@njit(forceinline=True)
def _into_tip(frame: Any, tool: Any, x: Any, y: Any, z: Any) -> Any:
    """A vector of the base as the tip sees it."""
    result = (
        frame[0] * x + frame[1] * y + frame[2] * z,
        frame[3] * x + frame[4] * y + frame[5] * z,
        frame[6] * x + frame[7] * y + frame[8] * z,
    )
    return (
        result[0] * tool[0] + result[1] * tool[1] + result[2] * tool[2],
        result[0] * tool[3] + result[1] * tool[4] + result[2] * tool[5],
        result[0] * tool[6] + result[1] * tool[7] + result[2] * tool[8],
    )


@njit(forceinline=True)
def _next_step(J: Any, e: Any, mu: Any, q: Any, q_min: Any, q_max: Any, slide: Any, length: Any, max_step: Any,
               step: Any) -> None:  # fmt: skip
    """The damped step of eight rows into ``step``, cut at the step limit and at the joint limits."""
    n, zero = slide.size, splat(0.0)
    A = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero,
         zero, zero, zero, zero, zero, zero)  # fmt: skip
    for j in range(n):
        i = 6 * j * W
        u0, u1, u2 = load(J, i), load(J, i + W), load(J, i + 2 * W)
        u3, u4, u5 = load(J, i + 3 * W), load(J, i + 4 * W), load(J, i + 5 * W)
        slope = u0 * e[0] + u1 * e[1] + u2 * e[2] + u3 * e[3] + u4 * e[4] + u5 * e[5]
        value = load(q, j * W)
        held = ((value >= q_max[j]) & (slope > 0.0)) | ((value <= q_min[j]) & (slope < 0.0))
        u0, u1, u2 = select(held, 0.0, u0), select(held, 0.0, u1), select(held, 0.0, u2)
        u3, u4, u5 = select(held, 0.0, u3), select(held, 0.0, u4), select(held, 0.0, u5)
        store(J, i, u0)
        store(J, i + W, u1)
        store(J, i + 2 * W, u2)
        store(J, i + 3 * W, u3)
        store(J, i + 4 * W, u4)
        store(J, i + 5 * W, u5)
        A = add_outer(A, (u0, u1, u2, u3, u4, u5))
    y0, y1, y2, y3, y4, y5 = solve6(A, mu, e)
    for j in range(n):
        i = 6 * j * W
        way = load(J, i) * y0 + load(J, i + W) * y1 + load(J, i + 2 * W) * y2
        way = way + load(J, i + 3 * W) * y3 + load(J, i + 4 * W) * y4 + load(J, i + 5 * W) * y5
        way = select(way > max_step, max_step, select(way < -max_step, -max_step, way))
        if slide[j] != 0.0:
            way = way * length
        old = load(q, j * W)
        new = old + way
        new = select(new > q_max[j], q_max[j], select(new < q_min[j], q_min[j], new))
        store(step, j * W, new - old)


@kernel
def damped_rows(
    base: Any, joints: Any, kinds: Any, tool: Any, q_min: Any, q_max: Any, slide: Any, length: float, T: Any, q0: Any,
    damping: Any, steps: int, max_step: float, q_out: Any, errors: Any, ahead: Any, slopes: Any, first: int, last: int,
) -> None:  # fmt: skip
    """See `damped`; arrays flat, ``first`` a multiple of 8."""
    n, m = slide.size, kinds.size // 2
    base, joints, tool = _unit_chain(base, joints, tool, kinds, length)
    q, frames, J, step = aligned(n * W), aligned(m * WALK), aligned(6 * n * W), aligned(n * W)
    target, spill, lanes = aligned(12 * W), aligned(21 * W), aligned(16 * W)
    seen, falls = aligned(6 * W), aligned(2 * n * W)
    rest = np.empty(W * max(2 * n, 6))
    row = first
    while row < last:
        whole = row + W <= last
        at = row if whole else 0
        load_targets(T if whole else padded(T, row, last, 16), at, tool, length, lanes, target)
        load_starts(q0 if whole else padded(q0, row, last, n), at, True, q_min, q_max, q)
        factor = load_column(damping if whole else padded(damping, row, last, 1), at, 1)
        for turn in range(steps + 1):
            frame = walk(base, joints, kinds, q, frames)
            p = tip_position(frame, tool)
            X = load(target, 0), load(target, W), load(target, 2 * W)
            Y = load(target, 3 * W), load(target, 4 * W), load(target, 5 * W)
            Z = load(target, 6 * W), load(target, 7 * W), load(target, 8 * W)
            e3, e4, e5 = _rotation_error(frame, X, Y, Z, spill, _ALL)
            e0, e1, e2 = load(target, 9 * W) - p[0], load(target, 10 * W) - p[1], load(target, 11 * W) - p[2]
            error = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3 + e4 * e4 + e5 * e5
            _columns(joints, kinds, frames, p, J, length)
            if turn == steps:
                _look(frame, tool, (e0, e1, e2, e3, e4, e5), J, slide, length, seen, falls)
            mu = error * factor + 1e-12
            _next_step(J, (e0, e1, e2, e3, e4, e5), mu, q, q_min, q_max, slide, length, max_step, step)
            if turn < steps:
                for j in range(n):
                    new = load(q, j * W) + load(step, j * W)  # rounding may pass the limit by the last digit
                    store(q, j * W, select(new > q_max[j], q_max[j], select(new < q_min[j], q_min[j], new)))
        _leave(q, q_out, row, last, n, rest)
        _leave(step, ahead, row, last, n, rest)
        _leave(seen, errors, row, last, 6, rest)
        _leave(falls, slopes, row, last, 2 * n, rest)
        row += W


@njit(forceinline=True)
def _look(frame: Any, tool: Any, e: Any, J: Any, slide: Any, length: float, seen: Any, falls: Any) -> None:
    """The error as the tip sees it, and J^T e of both its halves; J has slides in typical lengths, q in metres."""
    a = _into_tip(frame, tool, e[0], e[1], e[2])
    b = _into_tip(frame, tool, e[3], e[4], e[5])
    for i in range(3):
        store(seen, i * W, a[i])
        store(seen, (3 + i) * W, b[i])
    n = slide.size
    for j in range(n):
        i = 6 * j * W
        u = load(J, i) * e[0] + load(J, i + W) * e[1] + load(J, i + 2 * W) * e[2]
        v = load(J, i + 3 * W) * e[3] + load(J, i + 4 * W) * e[4] + load(J, i + 5 * W) * e[5]
        unit = 1.0 / length if slide[j] != 0.0 else 1.0
        store(falls, j * W, u * unit)
        store(falls, (n + j) * W, v * unit)


@njit(forceinline=True)
def _leave(lanes: Any, target: Any, row: int, last: int, n: int, rest: Any) -> None:
    """Lanes to the rows of a (B, n) array that are left."""
    if row + W <= last:
        scatter_rows(lanes, target, row, n)
        return
    scatter_rows(lanes, rest, 0, n)
    for i in range((last - row) * n):
        target[row * n + i] = rest[i]
