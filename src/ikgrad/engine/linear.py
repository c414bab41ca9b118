"""The 6 x 6 positive definite system of a damped step, eight at a time, unrolled."""

from __future__ import annotations

from typing import Any

from numba import njit

from ikgrad.engine.simd import select

_TINY = 1e-30  # a pivot is never smaller: rounding may leave none where the Jacobian has lost rank


@njit(forceinline=True)
def add_outer(A: Any, u: Any) -> Any:
    """``A + u u^T``, the lower triangle of a symmetric 6 x 6 matrix by rows."""
    a, b, c, d, e, f = u
    return (
        A[0] + a * a,
        A[1] + b * a,
        A[2] + b * b,
        A[3] + c * a,
        A[4] + c * b,
        A[5] + c * c,
        A[6] + d * a,
        A[7] + d * b,
        A[8] + d * c,
        A[9] + d * d,
        A[10] + e * a,
        A[11] + e * b,
        A[12] + e * c,
        A[13] + e * d,
        A[14] + e * e,
        A[15] + f * a,
        A[16] + f * b,
        A[17] + f * c,
        A[18] + f * d,
        A[19] + f * e,
        A[20] + f * f,
    )


@njit(forceinline=True)
def solve6(A: Any, mu: Any, b: Any) -> Any:
    """Y with ``(A + mu I) y = b`` by an L D L^T factorisation: six divisions, no square root.

    Args:
        A: the lower triangle by rows, 21 Vecs.
        mu: Vec, the damping.
        b: six Vecs.
    """
    a00 = A[0] + mu
    a10, a11 = A[1], A[2] + mu
    a20, a21, a22 = A[3], A[4], A[5] + mu
    a30, a31, a32, a33 = A[6], A[7], A[8], A[9] + mu
    a40, a41, a42, a43, a44 = A[10], A[11], A[12], A[13], A[14] + mu
    a50, a51, a52, a53, a54, a55 = A[15], A[16], A[17], A[18], A[19], A[20] + mu
    y0, y1, y2, y3, y4, y5 = b
    w0 = 1.0 / select(a00 > _TINY, a00, _TINY)
    l10 = a10 * w0
    a11 = a11 - l10 * a10
    y1 = y1 - l10 * y0
    l20 = a20 * w0
    a21 = a21 - l20 * a10
    a22 = a22 - l20 * a20
    y2 = y2 - l20 * y0
    l30 = a30 * w0
    a31 = a31 - l30 * a10
    a32 = a32 - l30 * a20
    a33 = a33 - l30 * a30
    y3 = y3 - l30 * y0
    l40 = a40 * w0
    a41 = a41 - l40 * a10
    a42 = a42 - l40 * a20
    a43 = a43 - l40 * a30
    a44 = a44 - l40 * a40
    y4 = y4 - l40 * y0
    l50 = a50 * w0
    a51 = a51 - l50 * a10
    a52 = a52 - l50 * a20
    a53 = a53 - l50 * a30
    a54 = a54 - l50 * a40
    a55 = a55 - l50 * a50
    y5 = y5 - l50 * y0
    w1 = 1.0 / select(a11 > _TINY, a11, _TINY)
    l21 = a21 * w1
    a22 = a22 - l21 * a21
    y2 = y2 - l21 * y1
    l31 = a31 * w1
    a32 = a32 - l31 * a21
    a33 = a33 - l31 * a31
    y3 = y3 - l31 * y1
    l41 = a41 * w1
    a42 = a42 - l41 * a21
    a43 = a43 - l41 * a31
    a44 = a44 - l41 * a41
    y4 = y4 - l41 * y1
    l51 = a51 * w1
    a52 = a52 - l51 * a21
    a53 = a53 - l51 * a31
    a54 = a54 - l51 * a41
    a55 = a55 - l51 * a51
    y5 = y5 - l51 * y1
    w2 = 1.0 / select(a22 > _TINY, a22, _TINY)
    l32 = a32 * w2
    a33 = a33 - l32 * a32
    y3 = y3 - l32 * y2
    l42 = a42 * w2
    a43 = a43 - l42 * a32
    a44 = a44 - l42 * a42
    y4 = y4 - l42 * y2
    l52 = a52 * w2
    a53 = a53 - l52 * a32
    a54 = a54 - l52 * a42
    a55 = a55 - l52 * a52
    y5 = y5 - l52 * y2
    w3 = 1.0 / select(a33 > _TINY, a33, _TINY)
    l43 = a43 * w3
    a44 = a44 - l43 * a43
    y4 = y4 - l43 * y3
    l53 = a53 * w3
    a54 = a54 - l53 * a43
    a55 = a55 - l53 * a53
    y5 = y5 - l53 * y3
    w4 = 1.0 / select(a44 > _TINY, a44, _TINY)
    l54 = a54 * w4
    a55 = a55 - l54 * a54
    y5 = y5 - l54 * y4
    w5 = 1.0 / select(a55 > _TINY, a55, _TINY)
    y5 = y5 * w5
    y4 = y4 * w4 - l54 * y5
    y3 = y3 * w3 - l43 * y4 - l53 * y5
    y2 = y2 * w2 - l32 * y3 - l42 * y4 - l52 * y5
    y1 = y1 * w1 - l21 * y2 - l31 * y3 - l41 * y4 - l51 * y5
    y0 = y0 * w0 - l10 * y1 - l20 * y2 - l30 * y3 - l40 * y4 - l50 * y5
    return y0, y1, y2, y3, y4, y5
