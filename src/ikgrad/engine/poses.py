"""Small jobs around a solve, one pass each: check targets, measure answers, bring angles near a configuration."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.parallel import for_chunks

Array = NDArray[np.float64]
_CHUNK = 8192
_TURN = 2 * math.pi
_ALL = np.ones(6)


def examine(T: Array, tolerance: float, *, threads: int = 1) -> tuple[Array, NDArray[np.bool_]]:
    """Targets with their rotations made orthonormal to rounding, and which of them were rigid transforms at all.

    Args:
        T: (B, 4, 4)
        tolerance: largest entry of |R^T R - I| and of the last row's deviation from 0 0 0 1.
        threads: threads to use.

    Returns:
        (B, 4, 4), the identity where the target is invalid; (B,) bool.
    """
    good, valid = np.empty((len(T), 4, 4)), np.empty(len(T), dtype=np.bool_)
    flat, out, run = np.ascontiguousarray(T).reshape(-1), good.reshape(-1), prepare(examine_rows)
    for_chunks(lambda a, b: run(flat, tolerance, out, valid, a, b), len(T), _CHUNK, threads)
    return good, valid


class Verdict(NamedTuple):
    """How good joint values are."""

    position_error: Array  # (B,) [m]
    rotation_error: Array  # (B,) [rad]
    success: NDArray[np.bool_]  # (B,) both within tolerance, joints inside the limits, target valid


def measure(
    T: Array,
    T_target: Array,
    valid: NDArray[np.bool_],
    q: Array,
    *,
    q_min: Array,
    q_max: Array,
    mask: Array | None,
    tol_pos: float,
    tol_rot: float,
    threads: int = 1,
) -> Verdict:
    """Distance and angle between the poses reached and the targets, and whether that is a success.

    Args:
        T: (B, 4, 4) poses reached, by forward kinematics of ``q``.
        T_target: (B, 4, 4)
        valid: (B,) from `examine`.
        q: (B, n) joint values.
        q_min: (n,) limits, infinite where there are none.
        q_max: (n,)
        mask: (6,) ones and zeros along the target's own axes, or None for all.
        tol_pos: [m]
        tol_rot: [rad]
        threads: threads to use.
    """
    position, rotation, success = np.empty(len(T)), np.empty(len(T)), np.empty(len(T), dtype=np.bool_)
    a, b, run = T.reshape(-1), T_target.reshape(-1), prepare(measure_rows)
    weights = _ALL if mask is None else mask
    args = a, b, valid, q, q_min, q_max, weights, tol_pos, tol_rot, position, rotation, success
    for_chunks(lambda i, j: run(*args, i, j), len(T), _CHUNK, threads)
    return Verdict(position, rotation, success)


def turn_near(q: Array, near: Array, q_min: Array, q_max: Array, periodic: NDArray[np.bool_]) -> None:
    """Add whole turns to each angle, in place, so that it is as near to ``near`` as its range allows.

    Args:
        q: (B, n) joint values inside the range, changed.
        near: (B, n)
        q_min: (n,)
        q_max: (n,)
        periodic: (n,) where a whole turn changes no pose.
    """
    prepare(turn_rows)(q, near, q_min, q_max, periodic)


@njit
def _polar_step(R: Any) -> None:
    """R <- R (3 I - R^T R) / 2: squares the distance to the nearest rotation."""
    S = np.empty(9)
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += R[3 * k + i] * R[3 * k + j]
            S[3 * i + j] = (1.5 if i == j else 0.0) - 0.5 * total
    for i in range(3):
        x, y, z = R[3 * i], R[3 * i + 1], R[3 * i + 2]
        for j in range(3):
            R[3 * i + j] = x * S[j] + y * S[3 + j] + z * S[6 + j]


@njit
def _is_rigid(T: Any, at: int, tolerance: float) -> bool:
    for i in range(16):
        if not math.isfinite(T[at + i]):
            return False
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += T[at + 4 * k + i] * T[at + 4 * k + j]
            if not abs(total - (1.0 if i == j else 0.0)) <= tolerance:
                return False
    bottom = max(abs(T[at + 12]), abs(T[at + 13]), abs(T[at + 14]), abs(T[at + 15] - 1.0))
    a, b, c = T[at], T[at + 1], T[at + 2]
    d, e, f = T[at + 4], T[at + 5], T[at + 6]
    g, h, i = T[at + 8], T[at + 9], T[at + 10]
    return bottom <= tolerance and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0


@kernel
def examine_rows(T: Any, tolerance: float, out: Any, valid: Any, first: int, last: int) -> None:
    """See `examine`; arrays flat."""
    R = np.empty(9)
    for row in range(first, last):
        at = 16 * row
        valid[row] = _is_rigid(T, at, tolerance)
        if not valid[row]:
            for i in range(16):
                out[at + i] = 1.0 if i % 5 == 0 else 0.0
            continue
        for i in range(9):
            R[i] = T[at + 4 * (i // 3) + i % 3]
        _polar_step(R)
        _polar_step(R)
        for i in range(3):
            for j in range(3):
                out[at + 4 * i + j] = R[3 * i + j]
            out[at + 4 * i + 3] = T[at + 4 * i + 3]
            out[at + 12 + i] = 0.0
        out[at + 15] = 1.0


@kernel
def measure_rows(
    T: Any, G: Any, valid: Any, q: Any, q_min: Any, q_max: Any, weights: Any, tol_pos: float, tol_rot: float,
    position: Any, rotation: Any, success: Any, first: int, last: int,
) -> None:  # fmt: skip
    """See `measure`; poses flat, G the targets. The angle is atan2(|vee(E - E^T)|, tr E - 1), E = R* R^T."""
    E, v, w = np.empty(9), np.empty(3), np.empty(3)
    masked = False
    for i in range(6):
        masked = masked or weights[i] != 1.0
    for row in range(first, last):
        at = 16 * row
        for i in range(3):
            v[i] = G[at + 4 * i + 3] - T[at + 4 * i + 3]
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += G[at + 4 * i + k] * T[at + 4 * j + k]
                E[3 * i + j] = total
        w[0], w[1], w[2] = E[7] - E[5], E[2] - E[6], E[3] - E[1]
        sine = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        angle = math.atan2(sine, E[0] + E[4] + E[8] - 1.0)
        if masked:
            _mask_errors(G, at, weights, v, w, angle / sine if sine > 1e-12 else 0.5, angle)
            angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        position[row] = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        rotation[row] = angle
        good = valid[row] and position[row] <= tol_pos and angle <= tol_rot
        for j in range(q.shape[1]):
            good = good and q_min[j] <= q[row, j] <= q_max[j]
        success[row] = good


@njit
def _mask_errors(G: Any, at: int, weights: Any, v: Any, w: Any, scale: float, angle: float) -> None:
    """Both error vectors into the target's frame, masked; exactly at pi the axis is lost and the angle is kept."""
    lost = angle > 3.0 and scale == 0.5
    for vector in range(2):
        x, y, z = (v[0], v[1], v[2]) if vector == 0 else (w[0] * scale, w[1] * scale, w[2] * scale)
        for j in range(3):
            turned = G[at + j] * x + G[at + 4 + j] * y + G[at + 8 + j] * z
            value = weights[3 * vector + j] * turned
            if vector == 0:
                v[j] = value
            else:
                w[j] = weights[3 + j] * angle if lost else value


@kernel
def turn_rows(q: Any, near: Any, q_min: Any, q_max: Any, periodic: Any) -> None:
    """See `turn_near`."""
    rows, n = q.shape
    for row in range(rows):
        for j in range(n):
            if periodic[j]:
                value = q[row, j]
                fewest = np.ceil((q_min[j] - value) / _TURN - 1e-12)
                most = np.floor((q_max[j] - value) / _TURN + 1e-12)
                turns = min(max(np.rint((near[row, j] - value) / _TURN), fewest), most)
                if fewest <= most and turns != 0 and math.isfinite(turns):
                    q[row, j] = min(max(value + _TURN * turns, q_min[j]), q_max[j])
