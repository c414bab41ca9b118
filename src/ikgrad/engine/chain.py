"""Kernels for the chain itself: forward kinematics, Jacobian and vector-Jacobian product of eight rows at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ikgrad.engine.cache import kernel
from ikgrad.engine.simd import W, load, load_column, splat, store, transpose
from ikgrad.engine.vecmath import cross, sincos

WALK = 6 * W  # floats a joint that `walk` leaves behind: its axis z and its origin p, eight lanes each


@njit(forceinline=True)
def aligned(size: int) -> Any:
    """Scratch memory that starts at a cache line, so that no vector lies across two."""
    raw = np.empty(size + 8)
    skip = (64 - raw.ctypes.data % 64) // 8 % 8
    return raw[skip : skip + size]


@njit(forceinline=True)
def first_frame(base: Any) -> Any:
    """The first joint's frame before its motion: columns x, y, z and origin p, 12 Vecs."""
    x, y = (splat(base[0]), splat(base[1]), splat(base[2])), (splat(base[3]), splat(base[4]), splat(base[5]))
    return *x, *y, splat(base[6]), splat(base[7]), splat(base[8]), splat(base[9]), splat(base[10]), splat(base[11])


@njit(forceinline=True)
def to_joint(frame: Any, joints: Any, k: int) -> Any:
    """From the moving frame before it to joint k's frame before its motion: a translation and a turn by b about x."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
    i = 9 * k
    tx, ty, tz, cb, sb = joints[i], joints[i + 1], joints[i + 2], joints[i + 3], joints[i + 4]
    px = px + xx * tx + yx * ty + zx * tz
    py = py + xy * tx + yy * ty + zy * tz
    pz = pz + xz * tx + yz * ty + zz * tz
    yx, zx = yx * cb + zx * sb, zx * cb - yx * sb
    yy, zy = yy * cb + zy * sb, zy * cb - yy * sb
    yz, zz = yz * cb + zz * sb, zz * cb - yz * sb
    return xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz


@njit(forceinline=True)
def through_joint(frame: Any, joints: Any, kinds: Any, q: Any, k: int) -> Any:
    """The motion of joint k: a turn about z, or a slide along it and a fixed turn."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
    i = 9 * k
    theta = load(q, kinds[2 * k + 1] * W) * joints[i + 5] + joints[i + 6]
    if kinds[2 * k] != 0:
        c, s = splat(joints[i + 7]), splat(joints[i + 8])
        px, py, pz = px + zx * theta, py + zy * theta, pz + zz * theta
    else:
        s, c = sincos(theta)
    xx, yx = xx * c + yx * s, yx * c - xx * s
    xy, yy = xy * c + yy * s, yy * c - xy * s
    xz, yz = xz * c + yz * s, yz * c - xz * s
    return xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz


@njit(forceinline=True)
def leave_joint(frame: Any, k: int, frames: Any) -> None:
    """Write z and p of joint k's frame into ``frames``."""
    j = k * WALK
    for i in range(6):
        store(frames, j + i * W, frame[6 + i])


@njit(forceinline=True)
def walk(base: Any, joints: Any, kinds: Any, q: Any, frames: Any) -> Any:
    """Go along the chain from the base to the last moving frame.

    Args:
        base: (12,) see `PackedChain`, like the next two.
        joints: (m * 9,)
        kinds: (m * 2,)
        q: (n * W,) joint values in lanes.
        frames: (m * 6 * W,) receives z and p of every joint in the base.

    Returns:
        The columns x, y, z and the origin p of the last moving frame, 12 Vecs.
    """
    frame = first_frame(base)
    for k in range(kinds.size // 2):
        if k > 0:  # the first joint's frame is the base's
            frame = to_joint(frame, joints, k)
        leave_joint(frame, k, frames)
        frame = through_joint(frame, joints, kinds, q, k)
    return frame


@njit(forceinline=True)
def rotate(frame: Any, vx: float, vy: float, vz: float) -> Any:
    """R v for a constant vector v."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = frame[:9]
    return xx * vx + yx * vy + zx * vz, xy * vx + yy * vy + zy * vz, xz * vx + yz * vy + zz * vz


@njit(forceinline=True)
def tip_position(frame: Any, tool: Any) -> Any:
    """Origin of the tip from the last moving frame."""
    dx, dy, dz = rotate(frame, tool[9], tool[10], tool[11])
    return frame[9] + dx, frame[10] + dy, frame[11] + dz


@njit(forceinline=True)
def tip_columns(frame: Any, tool: Any) -> Any:
    """Columns x, y, z of the tip from the last moving frame."""
    x = rotate(frame, tool[0], tool[1], tool[2])
    y = rotate(frame, tool[3], tool[4], tool[5])
    z = rotate(frame, tool[6], tool[7], tool[8])
    return x, y, z


@njit(forceinline=True)
def gather_rows(source: Any, row: int, n: int, lanes: Any) -> None:
    """Eight rows of a (B, n) array into lanes."""
    for j in range(n):
        store(lanes, j * W, load_column(source, row * n + j, n))


@njit(forceinline=True)
def scatter_rows(lanes: Any, target: Any, row: int, n: int) -> None:
    """Lanes back to eight rows of a (B, n) array, through registers where eight columns are left."""
    j = 0
    while j + W <= n:
        i = j * W
        rows = transpose(
            (
                load(lanes, i), load(lanes, i + W), load(lanes, i + 2 * W), load(lanes, i + 3 * W),
                load(lanes, i + 4 * W), load(lanes, i + 5 * W), load(lanes, i + 6 * W), load(lanes, i + 7 * W),
            )
        )  # fmt: skip
        at = row * n + j
        store(target, at, rows[0])
        store(target, at + n, rows[1])
        store(target, at + 2 * n, rows[2])
        store(target, at + 3 * n, rows[3])
        store(target, at + 4 * n, rows[4])
        store(target, at + 5 * n, rows[5])
        store(target, at + 6 * n, rows[6])
        store(target, at + 7 * n, rows[7])
        j += W
    for i in range(j, n):
        for lane in range(W):
            target[(row + lane) * n + i] = lanes[i * W + lane]


@njit(forceinline=True)
def _pose_block(frame: Any, tool: Any, T: Any, row: int, out: Any) -> None:
    x, y, z = tip_columns(frame, tool)
    p = tip_position(frame, tool)
    for i in range(3):
        store(out, (4 * i) * W, x[i])
        store(out, (4 * i + 1) * W, y[i])
        store(out, (4 * i + 2) * W, z[i])
        store(out, (4 * i + 3) * W, p[i])
    scatter_rows(out, T, row, 16)


@njit(forceinline=True)
def _jacobian_block(frame: Any, tool: Any, joints: Any, kinds: Any, frames: Any, n: int, out: Any) -> None:
    """Geometric Jacobian in lanes: element (i, j) at (i * n + j) * W."""
    p = tip_position(frame, tool)
    for i in range(6 * n):
        store(out, i * W, splat(0.0))
    for k in range(kinds.size // 2):
        j, column, multiplier = k * WALK, kinds[2 * k + 1], joints[9 * k + 5]
        z = load(frames, j), load(frames, j + W), load(frames, j + 2 * W)
        ox, oy, oz = load(frames, j + 3 * W), load(frames, j + 4 * W), load(frames, j + 5 * W)
        lever = cross(z[0], z[1], z[2], p[0] - ox, p[1] - oy, p[2] - oz)
        for i in range(3):
            a, b = (i * n + column) * W, ((i + 3) * n + column) * W
            if kinds[2 * k] != 0:
                store(out, a, load(out, a) + z[i] * multiplier)
            else:
                store(out, a, load(out, a) + lever[i] * multiplier)
                store(out, b, load(out, b) + z[i] * multiplier)


@njit(forceinline=True)
def _vjp_block(frame: Any, tool: Any, joints: Any, kinds: Any, frames: Any, g: Any, n: int, out: Any) -> None:
    """Gradient in lanes: row j at j * W. See `fk_vjp`."""
    x, y, z = tip_columns(frame, tool)
    p = tip_position(frame, tool)
    fx, fy, fz = load(g, 3 * W), load(g, 7 * W), load(g, 11 * W)
    torque = cross(p[0], p[1], p[2], fx, fy, fz)
    a = cross(x[0], x[1], x[2], load(g, 0), load(g, 4 * W), load(g, 8 * W))
    b = cross(y[0], y[1], y[2], load(g, W), load(g, 5 * W), load(g, 9 * W))
    c = cross(z[0], z[1], z[2], load(g, 2 * W), load(g, 6 * W), load(g, 10 * W))
    tx, ty, tz = torque[0] + a[0] + b[0] + c[0], torque[1] + a[1] + b[1] + c[1], torque[2] + a[2] + b[2] + c[2]
    for j in range(n):
        store(out, j * W, splat(0.0))
    for k in range(kinds.size // 2):
        j, at = k * WALK, kinds[2 * k + 1] * W
        zx, zy, zz = load(frames, j), load(frames, j + W), load(frames, j + 2 * W)
        ox, oy, oz = load(frames, j + 3 * W), load(frames, j + 4 * W), load(frames, j + 5 * W)
        if kinds[2 * k] != 0:
            slope = zx * fx + zy * fy + zz * fz
        else:
            mx, my, mz = cross(ox, oy, oz, fx, fy, fz)
            slope = zx * (tx - mx) + zy * (ty - my) + zz * (tz - mz)
        store(out, at, load(out, at) + slope * joints[9 * k + 5])


@njit(forceinline=True)
def padded(source: Any, row: int, rows: int, n: int) -> Any:
    """The last few rows, filled up to eight with copies of the last one."""
    block = np.empty(W * n)
    for lane in range(W):
        at = (row + min(lane, rows - row - 1)) * n
        for j in range(n):
            block[lane * n + j] = source[at + j]
    return block


@njit(forceinline=True)
def _copy(source: Any, target: Any, at: int, count: int) -> None:
    """A loop: Numba compiles an assignment between slices ten times slower."""
    for i in range(count):
        target[at + i] = source[i]


@kernel
def fk_rows(base: Any, joints: Any, kinds: Any, tool: Any, q: Any, T: Any, first: int, last: int, n: int) -> None:
    """Poses (B, 4, 4) of rows first..last of q (B, n), both flat; ``first`` is a multiple of 8."""
    lanes, frames, out = aligned(n * W), aligned(kinds.size // 2 * WALK), aligned(16 * W)
    for j in range(12, 16):
        store(out, j * W, splat(1.0 if j == 15 else 0.0))
    row = first
    while row < last:
        if row + W <= last:
            gather_rows(q, row, n, lanes)
        else:
            gather_rows(padded(q, row, last, n), 0, n, lanes)
        frame = walk(base, joints, kinds, lanes, frames)
        if row + W <= last:
            _pose_block(frame, tool, T, row, out)
        else:
            rest = np.empty(W * 16)
            _pose_block(frame, tool, rest, 0, out)
            _copy(rest, T, row * 16, (last - row) * 16)
        row += W


@kernel
def jacobian_rows(base: Any, joints: Any, kinds: Any, tool: Any, q: Any, J: Any, first: int, last: int, n: int) -> None:
    """Jacobians (B, 6, n) of rows first..last of q (B, n), both flat; ``first`` is a multiple of 8."""
    lanes, frames, out = aligned(n * W), aligned(kinds.size // 2 * WALK), aligned(6 * n * W)
    row = first
    while row < last:
        whole = row + W <= last
        gather_rows(q if whole else padded(q, row, last, n), row if whole else 0, n, lanes)
        frame = walk(base, joints, kinds, lanes, frames)
        _jacobian_block(frame, tool, joints, kinds, frames, n, out)
        if whole:
            scatter_rows(out, J, row, 6 * n)
        else:
            rest = np.empty(W * 6 * n)
            scatter_rows(out, rest, 0, 6 * n)
            _copy(rest, J, row * 6 * n, (last - row) * 6 * n)
        row += W


@kernel
def vjp_rows(
    base: Any, joints: Any, kinds: Any, tool: Any, q: Any, g: Any, grad: Any, first: int, last: int, n: int
) -> None:
    """Gradients (B, n) from dL/dT g (B, 4, 4) of rows first..last of q (B, n), all flat."""
    lanes, frames, out = aligned(n * W), aligned(kinds.size // 2 * WALK), aligned(n * W)
    g_lanes = aligned(16 * W)
    row = first
    while row < last:
        whole = row + W <= last
        at = row if whole else 0
        gather_rows(q if whole else padded(q, row, last, n), at, n, lanes)
        gather_rows(g if whole else padded(g, row, last, 16), at, 16, g_lanes)
        frame = walk(base, joints, kinds, lanes, frames)
        _vjp_block(frame, tool, joints, kinds, frames, g_lanes, n, out)
        if whole:
            scatter_rows(out, grad, row, n)
        else:
            rest = np.empty(W * n)
            scatter_rows(out, rest, 0, n)
            _copy(rest, grad, row * n, (last - row) * n)
        row += W
