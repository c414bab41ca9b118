"""How far from singular: condition number and manipulability of many Jacobians.

Singular values by one-sided Jacobi rotations (Hestenes 1958; de Rijk 1989): pairs of rows are turned until all rows are
orthogonal, and then their lengths are the singular values. Small ones keep their relative accuracy, which the
eigenvalues of J J^T would not.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.parallel import for_chunks

Array = NDArray[np.float64]
_CHUNK = 4096
_SWEEPS = 30  # four to six are enough as a rule
_ORTHOGONAL = 1e-14


def dexterity(J: Array, rows: Array, *, threads: int = 1) -> Array:
    """Condition number and manipulability of ``rows @ J``.

    Args:
        J: (B, 6, n) Jacobians, [linear; angular].
        rows: (k, 6) what to look at: scales of lengths, axes, a choice of directions.
        threads: threads to use.

    Returns:
        (B, 2): s_max / s_min, infinite at a singularity or if k > n, and s_1 s_2 ... s_k, which is sqrt(det A A^T) of
        A = rows J (Yoshikawa 1985).
    """
    count, _, n = J.shape
    out = np.empty((count, 2))
    flat, pick, result = np.ascontiguousarray(J).reshape(-1), np.ascontiguousarray(rows), out.reshape(-1)
    run = prepare(dexterity_rows)
    for_chunks(lambda a, b: run(flat, pick, n, result, a, b), count, _CHUNK, threads)
    return out


@kernel
def dexterity_rows(J: Any, rows: Any, n: int, out: Any, first: int, last: int) -> None:
    """See `dexterity`; Jacobians and results flat."""
    k = rows.shape[0]
    A = np.empty((k, n))
    for row in range(first, last):
        for i in range(k):
            for j in range(n):
                total = 0.0
                for m in range(6):
                    total += rows[i, m] * J[(row * 6 + m) * n + j]
                A[i, j] = total
        _make_orthogonal(A)
        least, most, product = math.inf, 0.0, 1.0
        for i in range(k):
            length = 0.0
            for j in range(n):
                length += A[i, j] * A[i, j]
            length = math.sqrt(length)
            least, most, product = min(least, length), max(most, length), product * length
        if k > n or not least > 1e-15 * most:
            least, product = 0.0, 0.0
        out[2 * row] = most / least if least > 0.0 else math.inf
        out[2 * row + 1] = product


@njit
def _make_orthogonal(A: Any) -> None:
    """Turn pairs of rows, in place, until they are orthogonal."""
    k, n = A.shape
    for _ in range(_SWEEPS):
        turned = False
        for a in range(k - 1):
            for b in range(a + 1, k):
                aa, bb, ab = 0.0, 0.0, 0.0
                for j in range(n):
                    aa += A[a, j] * A[a, j]
                    bb += A[b, j] * A[b, j]
                    ab += A[a, j] * A[b, j]
                if not abs(ab) > _ORTHOGONAL * math.sqrt(aa * bb):
                    continue
                turned = True
                zeta = (bb - aa) / (2.0 * ab)
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = c * t
                for j in range(n):
                    x, y = A[a, j], A[b, j]
                    A[a, j], A[b, j] = c * x - s * y, s * x + c * y
        if not turned:
            return
