"""Forward kinematics, Jacobian and vector-Jacobian product over numpy arrays.

Arrays are float64 and C-contiguous (others are copied); results are new arrays. Rows do not influence each other: a
row's result is the same bit for bit wherever it stands. A row of q with a NaN or an infinity gives NaN.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ikgrad.engine.cache import prepare
from ikgrad.engine.chain import fk_rows, jacobian_rows, vjp_rows
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.tables import PackedChain

Array = NDArray[np.float64]
_CHUNK = 4096  # rows; a multiple of the lanes


def _flat(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64).reshape(-1)


def fk(chain: PackedChain, q: Array, *, threads: int = 1) -> Array:
    """Pose of the tip in the base.

    Args:
        chain: from `pack`.
        q: (B, n) joint values [rad or m].
        threads: threads to use.

    Returns:
        (B, 4, 4)
    """
    rows, n = q.shape
    T = np.empty((rows, 4, 4))
    flat, out = _flat(q), T.reshape(-1)
    base, joints, kinds, tool = chain.base, chain.joints, chain.kinds, chain.tool
    run = prepare(fk_rows)
    for_chunks(lambda a, b: run(base, joints, kinds, tool, flat, out, a, b, n), rows, _CHUNK, threads)
    return T


def jacobian(chain: PackedChain, q: Array, *, threads: int = 1) -> Array:
    """Geometric Jacobian in the base frame, [linear; angular].

    Args:
        chain: from `pack`.
        q: (B, n) joint values [rad or m].
        threads: threads to use.

    Returns:
        (B, 6, n)
    """
    rows, n = q.shape
    J = np.empty((rows, 6, n))
    flat, out = _flat(q), J.reshape(-1)
    base, joints, kinds, tool = chain.base, chain.joints, chain.kinds, chain.tool
    run = prepare(jacobian_rows)
    for_chunks(lambda a, b: run(base, joints, kinds, tool, flat, out, a, b, n), rows, _CHUNK, threads)
    return J


def fk_vjp(chain: PackedChain, q: Array, grad_T: Array, *, threads: int = 1) -> Array:
    """Gradient of a loss with respect to q from its gradient with respect to the pose T(q), in one pass.

    A turn about the axis z through o moves the tip's columns c by z x c and its origin p by z x (p - o), so

        dL/dq = z . (sum_c c x dL/dc + (p - o) x dL/dp),   and z . dL/dp for a slide.

    Args:
        chain: from `pack`.
        q: (B, n) joint values [rad or m].
        grad_T: (B, 4, 4) dL/dT; its last row does not matter.
        threads: threads to use.

    Returns:
        (B, n)
    """
    rows, n = q.shape
    grad = np.empty((rows, n))
    flat, g, out = _flat(q), _flat(grad_T), grad.reshape(-1)
    base, joints, kinds, tool = chain.base, chain.joints, chain.kinds, chain.tool
    run = prepare(vjp_rows)
    for_chunks(lambda a, b: run(base, joints, kinds, tool, flat, g, out, a, b, n), rows, _CHUNK, threads)
    return grad
