"""Sine, cosine, the rotation logarithm, logistic and tanh for `Vec`, as polynomials (libm's do not vectorise)."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from ikgrad.engine.simd import bits, fabs, get_lane, has_bit, power_of_two, select, set_lane, sqrt

_TWO_OVER_PI = 2.0 / math.pi
_MAGIC = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to an integer, whose low bits are then the float's
_FAR = 1e5  # beyond it the reduction loses digits: libm, lane by lane


def _split_half_pi() -> tuple[float, float, float]:
    """pi/2 = a + b + c with 33 bits in a and in b."""
    from fractions import Fraction

    digits = 314159265358979323846264338327950288419716939937510582097494459230781640628620899
    half_pi = Fraction(digits, 2 * 10 ** (len(str(digits)) - 1))
    a = Fraction(math.floor(half_pi * 2**32), 2**32)
    b = Fraction(math.floor((half_pi - a) * 2**65), 2**65)
    return float(a), float(b), float(half_pi - a - b)


# Cody and Waite: the first two parts end in zeros, so that n * part is exact for |n| < 2^20
_PI_A, _PI_B, _PI_C = _split_half_pi()


@njit(forceinline=True)
def sincos(x: Any) -> Any:
    """(sin x, cos x) of each lane, absolute error below 3e-16 for |x| <= 1e5, libm's beyond.

    Reduction to |r| <= pi/4, then the minimax polynomials of Cephes.
    """
    shifted = x * _TWO_OVER_PI + _MAGIC
    n = shifted - _MAGIC
    r = ((x - n * _PI_A) - n * _PI_B) - n * _PI_C
    z = r * r
    s = z * 1.58962301576546568060e-10 + -2.50507477628578072866e-8
    s = s * z + 2.75573136213857245213e-6
    s = s * z + -1.98412698295895385996e-4
    s = s * z + 8.33333333332211858878e-3
    s = s * z + -1.66666666666666307295e-1
    s = (s * z) * r + r
    c = z * -1.13585365213876817300e-11 + 2.08757008419747316778e-9
    c = c * z + -2.75573141792967388112e-7
    c = c * z + 2.48015872888517045348e-5
    c = c * z + -1.38888888888730564116e-3
    c = c * z + 4.16666666666665929218e-2
    c = (c * z) * z + (1.0 - 0.5 * z)
    odd = has_bit(shifted, 0)
    sine, cosine = select(odd, c, s), select(odd, s, c)
    sine = select(has_bit(shifted, 1), -sine, sine)
    cosine = select(has_bit(shifted + 1.0, 1), -cosine, cosine)  # the sign of the sine one quadrant on
    far = bits(fabs(x) > _FAR)
    if far != 0:
        return _sincos_far(x, sine, cosine, far)
    return sine, cosine


@njit(inline="never")
def _sincos_far(x: Any, sine: Any, cosine: Any, far: Any) -> Any:
    for lane in range(8):
        if (far >> lane) & 1:
            angle = get_lane(x, lane)
            if math.isfinite(angle):
                sine = set_lane(sine, lane, math.sin(angle))
                cosine = set_lane(cosine, lane, math.cos(angle))
            else:
                sine = set_lane(sine, lane, math.nan)
                cosine = set_lane(cosine, lane, math.nan)
    return sine, cosine


_LOG2_E = 1.4426950408889634
_EXPONENT = _MAGIC + 1023.0  # adding it rounds to an integer k and leaves k + 1023 in the low bits
_LN2_A, _LN2_B = 0.693145751953125, 1.42860682030941723212e-6  # ln 2; the first part ends in zeros


@njit(forceinline=True)
def _exp_parts(x: Any) -> Any:
    """(q, p, s) of each lane with ``exp(x) = s (q + p) / (q - p)`` and s a power of two, for x in [-709, 710].

    Reduction to |r| <= ln(2) / 2, then the rational function of Cephes. A caller who divides anyway saves a division.
    """
    shifted = x * _LOG2_E + _EXPONENT
    n = shifted - _EXPONENT
    r = (x - n * _LN2_A) - n * _LN2_B
    z = r * r
    p = z * 1.26177193074810590878e-4 + 3.02994407707441961300e-2
    p = (p * z + 9.99999999999999999910e-1) * r
    q = z * 3.00198505138664455042e-6 + 2.52448340349684104192e-3
    q = q * z + 2.27265548208155028766e-1
    q = q * z + 2.00000000000000000005
    return q, p, power_of_two(shifted)


@njit(forceinline=True)
def _within(x: Any, low: float, high: float) -> Any:
    """Each lane clamped to [low, high]; NaN stays."""
    return select(x < low, low, select(x > high, high, x))


@njit(forceinline=True)
def logistic(x: Any) -> Any:
    """1 / (1 + exp(-x)) of each lane, within 2 ulp; 1 from 37 on, 0 below -709."""
    q, p, s = _exp_parts(_within(-x, -709.0, 710.0))  # s is 0 and infinity at the ends
    a = q - p
    return a / (a + s * (q + p))


@njit(forceinline=True)
def tanh(x: Any) -> Any:
    """Hyperbolic tangent of each lane, within 2 ulp also near 0; exactly +-1 beyond 20."""
    q, p, s = _exp_parts(_within(x + x, -40.0, 40.0))
    more, less = s + 1.0, s - 1.0  # less is exactly 0 near x = 0, so that nothing cancels
    return (q * less + p * more) / (q * more + p * less)


@njit(forceinline=True)
def cross(ax: Any, ay: Any, az: Any, bx: Any, by: Any, bz: Any) -> Any:
    """Cross product a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(forceinline=True)
def angle_over_sine(cosine: Any, sine_squared: Any) -> Any:
    """Theta / sin(theta) for theta in [0, pi): what turns ``(R - R^T) / 2`` into the logarithm of R.

    For theta <= pi/2 a polynomial in 1 - cos(theta), relative error 3e-13; beyond, that of pi - theta.
    Useless where theta is so near pi that the sine has lost its digits; see `log_near_pi`.
    """
    x = 1.0 - fabs(cosine)
    g = x * 0.0009140372276306152 + -0.005440067499876022
    g = g * x + 0.015369048342108727
    g = g * x + -0.026123691350221634
    g = g * x + 0.03008975414559245
    g = g * x + -0.023838552486267872
    g = g * x + 0.014491300342342583
    g = g * x + -0.004663063520638389
    g = g * x + 0.0042442364708676905
    g = g * x + 0.004953007114679053
    g = g * x + 0.011598926784103014
    g = g * x + 0.02539157398921521
    g = g * x + 0.05714315958084226
    g = g * x + 0.13333332421235622
    g = g * x + 0.33333333344195687
    g = g * x + 0.9999999999997845
    obtuse = cosine < 0.0
    if bits(obtuse) != 0:
        g = select(obtuse, math.pi / sqrt(sine_squared) - g, g)
    return g


@njit(forceinline=True)
def atan2_roughly(y: Any, x: Any) -> Any:
    """Angle of the point (x, y) to about 1e-5 rad: enough for a guess, and short. 0 at the origin."""
    a, b = fabs(x), fabs(y)
    steep = b > a
    big = select(steep, b, a)
    t = select(steep, a, b) / select(big > 0.0, big, 1.0)
    z = t * t
    r = z * -0.0117212 + 0.05265332
    r = r * z + -0.11643287
    r = r * z + 0.19354346
    r = r * z + -0.33262347
    r = (r * z + 0.99997726) * t
    r = select(steep, 0.5 * math.pi - r, r)
    r = select(x < 0.0, math.pi - r, r)
    return select(y < 0.0, -r, r)


@njit
def log_near_pi(E: Any) -> Any:
    """Logarithm of one rotation matrix whose angle is near pi, by way of its quaternion.

    The largest component of the quaternion comes from the diagonal (Shepperd), so nothing is divided by a small
    number; at exactly pi the sign of the axis is arbitrary.

    Args:
        E: (9,) the matrix by columns.

    Returns:
        The rotation vector, three floats.
    """
    xx, yy, zz = E[0], E[4], E[8]
    if xx >= yy and xx >= zz:
        x, y, z, w = 1.0 + xx - yy - zz, E[1] + E[3], E[2] + E[6], E[5] - E[7]
    elif yy >= zz:
        x, y, z, w = E[1] + E[3], 1.0 - xx + yy - zz, E[5] + E[7], E[6] - E[2]
    else:
        x, y, z, w = E[2] + E[6], E[5] + E[7], 1.0 - xx - yy + zz, E[1] - E[3]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    norm = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(norm, w) / norm
    return x * scale, y * scale, z * scale
