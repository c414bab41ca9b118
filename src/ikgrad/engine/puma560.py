"""The closed form of the PUMA 560, one pose at a time; `ikgrad.solvers.puma560` has equations and torch path."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.poses import _is_rigid

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_CHUNK = 2048
_TURN = 2 * math.pi
_SINGULAR, _SQUARE_SLACK, _LIMIT_SLACK = 1e-10, 1e-12, 1e-10  # as in the torch path


def branches(
    T: Array, theta4: Array, arm: tuple[float, ...], q_min: Array, q_max: Array, *, tolerance: float, threads: int = 1
) -> tuple[Array, Flags, Flags]:
    """All eight branches of each pose.

    Args:
        T: (B, 4, 4)
        theta4: (B,) what th4 is where the wrist is singular.
        arm: a2, a3, d2, d4, z0 [m].
        q_min: (6,) limits; infinite: angles stay between -pi and pi.
        q_max: (6,)
        tolerance: how far from rigid a pose may be.
        threads: threads to use.

    Returns:
        (B, 8, 6) joints, (B, 8) valid, (B, 8) singular.
    """
    q, valid, singular = np.empty((len(T), 8, 6)), np.empty((len(T), 8), np.bool_), np.empty((len(T), 8), np.bool_)
    flat, run = np.ascontiguousarray(T).reshape(-1), prepare(branch_rows)
    args = flat, np.ascontiguousarray(theta4), arm, q_min, q_max, tolerance, q, valid, singular
    for_chunks(lambda a, b: run(*args, a, b), len(T), _CHUNK, threads)
    return q, valid, singular


@njit
def _wrap(value: float, low: float, high: float) -> float:
    """An angle by one whole turn inside its limits where that helps, and back from within the slack."""
    a, b = low - _LIMIT_SLACK, high + _LIMIT_SLACK
    if value > b and value - _TURN >= a:
        value -= _TURN
    elif value < a and value + _TURN <= b:
        value += _TURN
    return min(max(value, low), high) if a <= value <= b else value


@njit
def _put(q: Any, t1: float, t2: float, t3: float, t4: float, t5: float, t6: float, low: Any, high: Any) -> bool:
    """Write (6,) joints; True if they are inside the limits."""
    q[0], q[1], q[2], q[3], q[4], q[5] = t1, t2, t3, t4, t5, t6
    inside = True
    for j in range(6):
        q[j] = _wrap(q[j], low[j], high[j])
        inside = inside and low[j] <= q[j] <= high[j]
    return inside


@njit
def _half_turn(angle: float) -> float:
    return angle - math.pi if angle > 0 else angle + math.pi


@njit
def _wrist(E: Any, s1: float, c1: float, s23: float, c23: float, chosen: float) -> tuple[float, float, float, bool]:
    """th4, th5, th6 and whether th4 was free, from (16,) pose entries."""
    M11 = c23 * (c1 * E[0] + s1 * E[4]) - s23 * E[8]
    M12 = c23 * (c1 * E[1] + s1 * E[5]) - s23 * E[9]
    x3 = c1 * E[2] + s1 * E[6]
    M13, M33 = c23 * x3 - s23 * E[10], s23 * x3 + c23 * E[10]
    M21, M22, M23 = c1 * E[4] - s1 * E[0], c1 * E[5] - s1 * E[1], c1 * E[6] - s1 * E[2]
    square = M13 * M13 + M23 * M23
    singular = square <= _SINGULAR * _SINGULAR
    if singular:
        s4, c4 = math.sin(chosen), math.cos(chosen)
    else:
        s5 = math.sqrt(square)
        s4, c4 = M23 / s5, M13 / s5
    t5 = math.atan2(c4 * M13 + s4 * M23, M33)
    t6 = math.atan2(c4 * M21 - s4 * M11, c4 * M22 - s4 * M12)
    return math.atan2(s4, c4), t5, t6, singular


@kernel
def branch_rows(
    T: Any, theta4: Any, arm: Any, q_min: Any, q_max: Any, tolerance: float, q: Any, valid: Any, singular: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """See `branches`; poses flat."""
    a2, a3, d2, d4, z0 = arm
    L2 = a3 * a3 + d4 * d4
    L = math.sqrt(L2)
    E = np.empty(16)
    for row in range(first, last):
        at = 16 * row
        good = _is_rigid(T, at, tolerance)
        for i in range(16):
            E[i] = T[at + i] if good else (1.0 if i % 5 == 0 else 0.0)
        px, py, pz = E[3], E[7], E[11] - z0
        if px * px + py * py < 1e-12:
            px, py = 0.0, 1e-6
        rho2 = px * px + py * py - d2 * d2
        rho = math.sqrt(max(rho2, 0.0))
        K = (rho * rho + pz * pz - a2 * a2 - L2) / (2 * a2)
        W2 = L2 - K * K
        W, K = math.sqrt(max(W2, 0.0)), min(max(K, -L), L)
        good = good and rho2 >= -_SQUARE_SLACK and W2 >= -_SQUARE_SLACK
        if rho * rho + pz * pz < 1e-12:
            pz = 1.0
        for sign in range(2):  # of W
            w = W if sign == 0 else -W
            s3, c3 = (d4 * K + a3 * w) / L2, (a3 * K - d4 * w) / L2
            theta3 = math.atan2(s3, c3)
            A, B = a3 + a2 * c3, d4 + a2 * s3
            for shoulder in range(2):
                r = rho if shoulder == 0 else -rho
                y, x = r * py - d2 * px, r * px + d2 * py
                norm = math.sqrt(x * x + y * y)
                s1, c1 = y / norm, x / norm
                y, x = B * r - A * pz, A * r + B * pz
                norm = math.sqrt(x * x + y * y)
                s23, c23 = y / norm, x / norm
                theta1, theta2 = math.atan2(s1, c1), math.atan2(s23 * c3 - c23 * s3, c23 * c3 + s23 * s3)
                t4, t5, t6, free = _wrist(E, s1, c1, s23, c23, theta4[row])
                b = 4 * shoulder + 2 * (sign ^ shoulder)  # up: W has the sign of rho
                inside = _put(q[row, b], theta1, theta2, theta3, t4, t5, t6, q_min, q_max)
                valid[row, b] = good and inside
                flipped = q[row, b + 1]
                inside = _put(flipped, theta1, theta2, theta3, _half_turn(t4), -t5, _half_turn(t6), q_min, q_max)
                valid[row, b + 1] = good and inside
                singular[row, b], singular[row, b + 1] = free, free
