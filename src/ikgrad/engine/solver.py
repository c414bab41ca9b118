"""The whole Levenberg-Marquardt solve of a chunk of rows in one kernel, eight starts side by side.

Every lane works on its own row. All lanes take a damped step together; a lane whose start has converged or is given
up gets the row's next start or the next row at once, so no lane waits for another. One step, with the errors e and
the Jacobian J of the lane, lengths divided by the arm's typical length:

    dq = J^T (J J^T + mu I)^-1 e,   mu = damping |e|^2 + 1e-12

A joint at a limit whose gradient points outwards leaves J for this step (active set); the step is cut at
``max_step`` a joint, then at the limits. A redundant arm that starts from a given q0 uses its spare freedom to turn
away from the limits,

    dq = z + J^T (J J^T + mu I)^-1 (e - J z),   z_j = -3 |e| x_j^3,   x_j in [-1, 1] the place of the joint in its range

or it would drift into them along a path, since the shortest steps do not come back to where they began.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from ikgrad.engine.cache import kernel
from ikgrad.engine.chain import WALK, aligned, padded, rotate, tip_position, walk
from ikgrad.engine.linear import add_outer, solve6
from ikgrad.engine.simd import NO_LANES, W, bits, load, mask_of, select, splat, sqrt, store
from ikgrad.engine.starts import load_starts, load_targets, next_starts
from ikgrad.engine.vecmath import angle_over_sine, cross, log_near_pi

_NEAR_PI = -0.9999  # cosine below which the rotation error is taken from the quaternion
_SPARING = 3.0  # rad per unit error at the limit
_HUGE = 1e200


@njit(forceinline=True)
def _rotation_error(frame: Any, X: Any, Y: Any, Z: Any, spill: Any, active: int) -> Any:
    """log(R* R^T) from the columns of R and R*, three Vecs."""
    a = cross(frame[0], frame[1], frame[2], X[0], X[1], X[2])
    b = cross(frame[3], frame[4], frame[5], Y[0], Y[1], Y[2])
    c = cross(frame[6], frame[7], frame[8], Z[0], Z[1], Z[2])
    wx, wy, wz = 0.5 * (a[0] + b[0] + c[0]), 0.5 * (a[1] + b[1] + c[1]), 0.5 * (a[2] + b[2] + c[2])
    trace = frame[0] * X[0] + frame[1] * X[1] + frame[2] * X[2]
    trace = trace + frame[3] * Y[0] + frame[4] * Y[1] + frame[5] * Y[2]
    trace = trace + frame[6] * Z[0] + frame[7] * Z[1] + frame[8] * Z[2]
    cosine = 0.5 * trace - 0.5
    factor = angle_over_sine(cosine, wx * wx + wy * wy + wz * wz)
    wx, wy, wz = wx * factor, wy * factor, wz * factor
    near_pi = bits(cosine < _NEAR_PI) & active
    if near_pi != 0:
        for i in range(9):
            store(spill, i * W, frame[i])
        for i in range(3):
            store(spill, (9 + i) * W, X[i])
            store(spill, (12 + i) * W, Y[i])
            store(spill, (15 + i) * W, Z[i])
        store(spill, 18 * W, wx)
        store(spill, 19 * W, wy)
        store(spill, 20 * W, wz)
        _log_lanes(spill, near_pi)
        wx, wy, wz = load(spill, 18 * W), load(spill, 19 * W), load(spill, 20 * W)
    return wx, wy, wz


@njit
def _log_lanes(spill: Any, lanes: int) -> None:
    """Overwrite the rotation error of the lanes near pi."""
    E = np.empty(9)
    for lane in range(W):
        if (lanes >> lane) & 1:
            for column in range(3):
                for row in range(3):
                    total = 0.0
                    for k in range(3):
                        total += spill[(9 + 3 * k + row) * W + lane] * spill[(3 * k + column) * W + lane]
                    E[3 * column + row] = total
            wx, wy, wz = log_near_pi(E)
            spill[18 * W + lane], spill[19 * W + lane], spill[20 * W + lane] = wx, wy, wz


@njit(forceinline=True)
def target_columns(target: Any, tool: Any) -> Any:
    """Columns of R*, from R* R_tool^T."""
    x = load(target, 0), load(target, W), load(target, 2 * W)
    y = load(target, 3 * W), load(target, 4 * W), load(target, 5 * W)
    z = load(target, 6 * W), load(target, 7 * W), load(target, 8 * W)
    turned = (x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2])
    return (
        rotate(turned, tool[0], tool[1], tool[2]),
        rotate(turned, tool[3], tool[4], tool[5]),
        rotate(turned, tool[6], tool[7], tool[8]),
    )


@njit(forceinline=True)
def _into(columns: Any, x: Any, y: Any, z: Any) -> Any:
    """R^T v for the rotation with these columns."""
    a, b, c = columns
    return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z


@njit(forceinline=True)
def _turning_column(joints: Any, frames: Any, k: int, p: Any) -> Any:
    """Jacobian column of a turning joint that is the only one of its variable."""
    j, multiplier = k * WALK, joints[9 * k + 5]
    zx, zy, zz = load(frames, j) * multiplier, load(frames, j + W) * multiplier, load(frames, j + 2 * W) * multiplier
    ox, oy, oz = load(frames, j + 3 * W), load(frames, j + 4 * W), load(frames, j + 5 * W)
    lx, ly, lz = cross(zx, zy, zz, p[0] - ox, p[1] - oy, p[2] - oz)
    return lx, ly, lz, zx, zy, zz


@njit(forceinline=True)
def _columns(joints: Any, kinds: Any, frames: Any, p: Any, J: Any, length: float) -> None:
    """Jacobian columns in lanes, six Vecs a variable; an angle in rad, a slide in typical lengths."""
    for i in range(J.size // W):
        store(J, i * W, splat(0.0))
    for k in range(kinds.size // 2):
        j, at, multiplier = k * WALK, kinds[2 * k + 1] * 6 * W, joints[9 * k + 5]
        zx, zy, zz = load(frames, j), load(frames, j + W), load(frames, j + 2 * W)
        if kinds[2 * k] != 0:
            multiplier *= length
            store(J, at, load(J, at) + zx * multiplier)
            store(J, at + W, load(J, at + W) + zy * multiplier)
            store(J, at + 2 * W, load(J, at + 2 * W) + zz * multiplier)
        else:
            ox, oy, oz = load(frames, j + 3 * W), load(frames, j + 4 * W), load(frames, j + 5 * W)
            lx, ly, lz = cross(zx, zy, zz, p[0] - ox, p[1] - oy, p[2] - oz)
            store(J, at, load(J, at) + lx * multiplier)
            store(J, at + W, load(J, at + W) + ly * multiplier)
            store(J, at + 2 * W, load(J, at + 2 * W) + lz * multiplier)
            store(J, at + 3 * W, load(J, at + 3 * W) + zx * multiplier)
            store(J, at + 4 * W, load(J, at + 4 * W) + zy * multiplier)
            store(J, at + 5 * W, load(J, at + 5 * W) + zz * multiplier)


@njit
def _unit_chain(base: Any, joints: Any, tool: Any, kinds: Any, length: float) -> Any:
    """The chain with lengths divided by the typical length; q keeps its units."""
    base, joints, tool = base.copy(), joints.copy(), tool.copy()
    for i in range(3):
        base[9 + i] /= length
        tool[9 + i] /= length
    for k in range(kinds.size // 2):
        for i in range(3):
            joints[9 * k + i] /= length
        if kinds[2 * k] != 0:
            joints[9 * k + 5] /= length
            joints[9 * k + 6] /= length
    return base, joints, tool


@kernel
def solve_rows(
    base: Any, joints: Any, kinds: Any, tool: Any, q_min: Any, q_max: Any, low: Any, high: Any, slide: Any,
    length: float, grid: Any, blocks: Any, features: Any, records: Any, T: Any, q0: Any,
    weights: Any, settings: Any, counts: Any, q_out: Any, errors: Any, info: Any, first: int, last: int,
) -> None:  # fmt: skip
    """Solve rows first..last; see `solve.solve` for what the arguments mean.

    First the fields of `PackedChain`, then, all flat: targets (B * 16), first starts (B * n) or none, weights (6),
    settings (tol_pos, tol_rot, damping, max_step, stall factor of the squared error), counts (seed, max_steps,
    max_starts, limits, masked, patience); the results q_out (B * n), errors (B * 2: position, rotation) and info
    (B * 3: steps, starts, converged).
    """
    n, m = low.size, kinds.size // 2
    seed, max_steps, max_starts = counts[0], counts[1], counts[2]
    limits, masked, patience, guesses = counts[3] != 0, counts[4] != 0, float(counts[5]), counts[6]
    tol_pos, tol_rot = (settings[0] / length) ** 2, settings[1] ** 2
    damping, max_step, stall, near = settings[2], settings[3], settings[4], settings[5]
    has_q0 = q0.size > 0
    sparing = has_q0 and limits and n > 6
    simple = n == m  # one turning joint a variable, in order: its column needs no detour
    for k in range(m):
        simple = simple and kinds[2 * k] == 0 and kinds[2 * k + 1] == k
    base, joints, tool = _unit_chain(base, joints, tool, kinds, length)
    q, frames, J, wish = aligned(n * W), aligned(m * WALK), aligned(6 * n * W), aligned(n * W)
    target, spill, measured = aligned(12 * W), aligned(21 * W), aligned(3 * W)
    rows, starts, totals = np.zeros(W, np.int64), np.zeros(W, np.int64), np.zeros(W, np.int64)
    best, ages = np.zeros(W), aligned(W)
    q[:], target[:], ages[:], wish[:] = 0.0, 0.0, 0.0, 0.0
    # the next eight rows, made ready together
    next_target, next_q, lanes = aligned(12 * W), aligned(n * W), aligned(16 * W)
    next_rows, no_starts, sound = np.zeros(W, np.int64), np.zeros(W, np.int64), NO_LANES
    next_q[:] = 0.0
    ranks, jitter, scratch = np.zeros(W, np.int64), aligned(5 * W), aligned(9 * W)
    history1 = history2 = history3 = splat(math.inf)
    cursor, active, failed = first, NO_LANES, NO_LANES
    done = (1 << W) - 1  # every lane asks for its first row
    while True:
        # (1) lanes that are done get the row's next start or the next row
        if done != 0:
            again = NO_LANES
            for lane in range(W):
                bit = 1 << lane
                if not done & bit:
                    continue
                if active & bit:
                    row = rows[lane]
                    totals[lane] += int(ages[lane]) - 1
                    starts[lane] += 1
                    error = measured[2 * W + lane]
                    converged = not failed & bit
                    if converged or not best[lane] <= error:  # best is NaN at first
                        best[lane] = error
                        for j in range(n):
                            q_out[row * n + j] = q[j * W + lane]
                        errors[2 * row] = math.sqrt(measured[lane]) * length
                        errors[2 * row + 1] = math.sqrt(measured[W + lane])
                    ages[lane] = 0.0
                    if not converged and starts[lane] < max_starts:
                        again |= bit
                        continue
                    info[3 * row], info[3 * row + 1], info[3 * row + 2] = totals[lane], starts[lane], converged
                active &= ~bit
                while cursor < last:
                    row = cursor
                    cursor += 1
                    slot = (row - first) % W
                    if slot == 0:
                        whole, at = row + W <= last, row if row + W <= last else 0
                        sound = load_targets(
                            T if whole else padded(T, row, last, 16), at, tool, length, lanes, next_target
                        )
                        given = NO_LANES
                        if has_q0:
                            given = load_starts(
                                q0 if whole else padded(q0, row, last, n), at, limits, q_min, q_max, next_q
                            )
                        for i in range(W):
                            next_rows[i] = min(row + i, last - 1)
                        if sound & ~given:
                            next_starts(
                                T, q0, next_rows, no_starts, sound & ~given, guesses, seed, base, joints, kinds,
                                tool, low, high, length, grid, blocks, features, records, next_target, next_q,
                                ranks, jitter, scratch,
                            )  # fmt: skip
                    if (sound >> slot) & 1:
                        for i in range(12):
                            target[i * W + lane] = next_target[i * W + slot]
                        for j in range(n):
                            q[j * W + lane] = next_q[j * W + slot]
                        rows[lane], starts[lane], totals[lane], best[lane] = row, 0, 0, math.nan
                        active |= bit
                        break
                    for j in range(n):
                        q_out[row * n + j] = 0.5 * (low[j] + high[j])
                    errors[2 * row] = errors[2 * row + 1] = math.nan
                    info[3 * row] = info[3 * row + 1] = info[3 * row + 2] = 0
            if again != 0:
                next_starts(
                    T, q0, rows, starts, again, guesses, seed, base, joints, kinds, tool, low, high, length, grid,
                    blocks, features, records, target, q, ranks, jitter, scratch,
                )  # fmt: skip
            renewed = mask_of(done)
            history1 = select(renewed, math.inf, history1)
            history2 = select(renewed, math.inf, history2)
            history3 = select(renewed, math.inf, history3)
            if active == 0:
                return
        # (2) errors
        frame = walk(base, joints, kinds, q, frames)
        p = tip_position(frame, tool)
        X = load(target, 0), load(target, W), load(target, 2 * W)
        Y = load(target, 3 * W), load(target, 4 * W), load(target, 5 * W)
        Z = load(target, 6 * W), load(target, 7 * W), load(target, 8 * W)
        e3, e4, e5 = _rotation_error(frame, X, Y, Z, spill, active)
        e0, e1, e2 = load(target, 9 * W) - p[0], load(target, 10 * W) - p[1], load(target, 11 * W) - p[2]
        if masked:
            turn = target_columns(target, tool)
            e0, e1, e2 = _into(turn, e0, e1, e2)
            e3, e4, e5 = _into(turn, e3, e4, e5)
            e0 = e0 * (1.0 if weights[0] > 0.0 else 0.0)
            e1 = e1 * (1.0 if weights[1] > 0.0 else 0.0)
            e2 = e2 * (1.0 if weights[2] > 0.0 else 0.0)
            e3 = e3 * (1.0 if weights[3] > 0.0 else 0.0)
            e4 = e4 * (1.0 if weights[4] > 0.0 else 0.0)
            e5 = e5 * (1.0 if weights[5] > 0.0 else 0.0)
        position = e0 * e0 + e1 * e1 + e2 * e2
        rotation = e3 * e3 + e4 * e4 + e5 * e5
        if masked:
            e0, e1, e2 = e0 * weights[0], e1 * weights[1], e2 * weights[2]
            e3, e4, e5 = e3 * weights[3], e4 * weights[4], e5 * weights[5]
        error = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3 + e4 * e4 + e5 * e5
        # (3) who is done
        solved = (position <= tol_pos) & (rotation <= tol_rot)
        age = load(ages, 0) + 1.0
        store(ages, 0, age)
        hopeless = (age > patience) & (error > stall * history3) & (error > near)
        hopeless = hopeless | ((age > 20.0) & (error > 0.81 * history3))
        hopeless = hopeless | (age > float(max_steps)) | ~(error < _HUGE)
        history3, history2, history1 = history2, history1, error
        done = bits(solved | hopeless) & active
        if done != 0:
            failed = ~bits(solved)
            store(measured, 0, position)
            store(measured, W, rotation)
            store(measured, 2 * W, error)
        # (4) the damped step
        if not simple:
            _columns(joints, kinds, frames, p, J, length)
        zero = splat(0.0)
        A = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero,
             zero, zero, zero, zero, zero, zero)  # fmt: skip
        r0, r1, r2, r3, r4, r5 = e0, e1, e2, e3, e4, e5
        eager = -_SPARING * sqrt(error)
        for j in range(n):
            i = 6 * j * W
            if simple:
                u0, u1, u2, u3, u4, u5 = _turning_column(joints, frames, j, p)
            else:
                u0, u1, u2 = load(J, i), load(J, i + W), load(J, i + 2 * W)
                u3, u4, u5 = load(J, i + 3 * W), load(J, i + 4 * W), load(J, i + 5 * W)
            if masked:
                turn = target_columns(target, tool)
                u0, u1, u2 = _into(turn, u0, u1, u2)
                u3, u4, u5 = _into(turn, u3, u4, u5)
                u0, u1, u2 = u0 * weights[0], u1 * weights[1], u2 * weights[2]
                u3, u4, u5 = u3 * weights[3], u4 * weights[4], u5 * weights[5]
            if limits:
                slope = u0 * e0 + u1 * e1 + u2 * e2 + u3 * e3 + u4 * e4 + u5 * e5
                value = load(q, j * W)
                held = ((value >= q_max[j]) & (slope > 0.0)) | ((value <= q_min[j]) & (slope < 0.0))
                u0, u1, u2 = select(held, 0.0, u0), select(held, 0.0, u1), select(held, 0.0, u2)
                u3, u4, u5 = select(held, 0.0, u3), select(held, 0.0, u4), select(held, 0.0, u5)
                if sparing and q_max[j] - q_min[j] < _HUGE:
                    where = (value - 0.5 * (q_max[j] + q_min[j])) / (0.5 * (q_max[j] - q_min[j]))
                    z = select(held, 0.0, where * where * where * eager)
                    store(wish, j * W, z)
                    r0, r1, r2 = r0 - u0 * z, r1 - u1 * z, r2 - u2 * z
                    r3, r4, r5 = r3 - u3 * z, r4 - u4 * z, r5 - u5 * z
            if masked or limits or simple:
                store(J, i, u0)
                store(J, i + W, u1)
                store(J, i + 2 * W, u2)
                store(J, i + 3 * W, u3)
                store(J, i + 4 * W, u4)
                store(J, i + 5 * W, u5)
            A = add_outer(A, (u0, u1, u2, u3, u4, u5))
        y0, y1, y2, y3, y4, y5 = solve6(A, error * damping + 1e-12, (r0, r1, r2, r3, r4, r5))
        idle = mask_of(done | ~active)
        for j in range(n):
            i = 6 * j * W
            step = load(J, i) * y0 + load(J, i + W) * y1 + load(J, i + 2 * W) * y2
            step = step + load(J, i + 3 * W) * y3 + load(J, i + 4 * W) * y4 + load(J, i + 5 * W) * y5
            if sparing:
                step = step + load(wish, j * W)
            step = select(step > max_step, max_step, select(step < -max_step, -max_step, step))
            if slide[j] != 0.0:
                step = step * length
            old = load(q, j * W)
            new = old + select(idle, 0.0, step)
            if limits:
                new = select(new > q_max[j], q_max[j], select(new < q_min[j], q_min[j], new))
            store(q, j * W, new)
