"""Batches of joint motions as `check_motion` sees them: places at times, and bounds on speeds between times.

Rows are motions. Where a function takes ``row`` and ``t``, both (M,), it answers for motion ``row[i]`` at time
``t[i]``: the check refines each motion where it needs to, and asks for any mixture of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from ikgrad.collision.checks import check_bound, check_finite, check_tensor
from ikgrad.errors import ConfigError, ShapeError

JUMP = 1e-6  # difference of neighbouring pieces at a break that counts as rounding [rad or m]


class Motion(Protocol):
    """B motions of n joints, in float64."""

    @property
    def shape(self) -> torch.Size:
        """Batch shape, B in all."""

    @property
    def breaks(self) -> Tensor:
        """(B, k) increasing times, the first and the last included; the first intervals to look at."""

    @property
    def continuous(self) -> bool:
        """True if `position` answers between the breaks too."""

    def position(self, row: Tensor, t: Tensor) -> Tensor:
        """(M, n) joint values."""

    def speed(self, row: Tensor, t0: Tensor, t1: Tensor) -> Tensor:
        """(M, n) bounds on the absolute joint speeds between two times; no break lies inside."""


class PolynomialMotion:
    """Piecewise polynomials, with the tightest cheap bound on their speed.

    q(t) = sum_i coefficients[..., k, i, :] (t - times[k])^i in piece k, the form of `ikgrad.via_point_trajectory`. On
    an interval a speed lies between the least and the largest of the polynomial's Bernstein coefficients there.

    Args:
        times: (S + 1,) or (..., S + 1) increasing break times [s].
        coefficients: (..., S, d + 1, n), any degree d.

    Raises:
        ShapeError: a shape does not fit.
        ConfigError: times do not increase, something is not finite, or a joint jumps at a break.

    Example:
        >>> import torch
        >>> from ikgrad.collision import PolynomialMotion
        >>> line = PolynomialMotion(torch.tensor([0.0, 2.0]), torch.tensor([[[0.0, 1.0], [0.5, -1.0]]]))
        >>> line.position(torch.tensor([0]), torch.tensor([1.0]))
        tensor([[0.5000, 0.0000]], dtype=torch.float64)
    """

    continuous = True

    def __init__(self, times: Tensor, coefficients: Tensor):
        good = isinstance(coefficients, Tensor) and coefficients.ndim >= 3 and 0 not in coefficients.shape[-3:]
        check_tensor("coefficients", coefficients, "(..., S, d + 1, n)", good)
        check_finite("coefficients", coefficients)
        self.shape, self.breaks = _times(times, coefficients.shape[:-3], coefficients.shape[-3] + 1)
        pieces = coefficients.detach().double()
        self._pieces = pieces.expand(*self.shape, *pieces.shape[-3:]).reshape(-1, *pieces.shape[-3:])  # (B, S, d+1, n)
        self._check_jumps()

    def position(self, row: Tensor, t: Tensor) -> Tensor:
        """(M, n) joint values."""
        piece, start = self._piece(row, t)
        return _horner(piece, t - start)

    def speed(self, row: Tensor, t0: Tensor, t1: Tensor) -> Tensor:
        """(M, n) bounds on the absolute speeds, exact in the limit of short intervals."""
        piece, start = self._piece(row, (t0 + t1) / 2)
        degree = piece.shape[1] - 1
        if degree == 0:
            return torch.zeros_like(piece[:, 0])
        slope = piece[:, 1:] * torch.arange(1.0, degree + 1).to(piece)[:, None]  # (M, d, n) coefficients of qd
        s, h = t0 - start, t1 - t0
        at_start, scale = [], torch.ones_like(h)  # qd(s + u h) = sum_k at_start[k] u^k
        for k in range(degree):
            at_start.append(_horner(slope, s) * (scale / math.factorial(k))[:, None])
            slope = slope[:, 1:] * torch.arange(1.0, slope.shape[1]).to(piece)[:, None]
            scale = scale * h
        bernstein = [
            sum(math.comb(j, k) / math.comb(degree - 1, k) * at_start[k] for k in range(j + 1)) for j in range(degree)
        ]
        return torch.stack([torch.as_tensor(b) for b in bernstein]).abs().amax(dim=0)

    def _piece(self, row: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        """(M, d + 1, n) coefficients and (M,) start of the pieces that hold the times."""
        breaks = self.breaks[row]
        index = torch.searchsorted(breaks, t[:, None], right=True)[:, 0] - 1
        index = index.clamp(0, self._pieces.shape[1] - 1)
        return self._pieces[row, index], breaks.gather(1, index[:, None])[:, 0]

    def _check_jumps(self) -> None:
        h = self.breaks.diff(dim=-1)
        ends = _horner(self._pieces.flatten(0, 1), h.flatten()).view(*h.shape, -1)  # (B, S, n)
        jump = (ends[:, :-1] - self._pieces[:, 1:, 0]).abs()
        bad = jump > JUMP * (1 + ends[:, :-1].abs())
        if bool(bad.any()):
            row, k, joint = (int(i) for i in torch.nonzero(bad)[0])
            raise ConfigError(
                f"motion {row} jumps by {jump[row, k, joint].item():.3g} in joint {joint} at times[{k + 1}]: "
                "neighbouring pieces must meet"
            )


class FunctionMotion:
    """Motions given by any function of time, with a bound on their speed.

    Args:
        position: (row, t) -> (M, n) joint values of motions ``row`` (M,) int64 at times ``t`` (M,) float64.
        speed_bound: (row, t0, t1) -> (M, n) numbers that the absolute joint speeds between t0 and t1 never exceed.
        times: (k,) or (B, k) start and end, and breaks between them if ``speed_bound`` likes them [s].
        count: number B of motions.

    Raises:
        ShapeError: ``times`` does not fit.
        ConfigError: times do not increase or are not finite.

    Example:
        >>> import torch
        >>> from ikgrad.collision import FunctionMotion
        >>> swing = FunctionMotion(
        ...     lambda row, t: t.sin()[:, None].expand(-1, 7),
        ...     lambda row, t0, t1: torch.ones(len(row), 7),
        ...     torch.tensor([0.0, 3.0]),
        ...     count=1,
        ... )
    """

    continuous = True

    def __init__(
        self,
        position: Callable[[Tensor, Tensor], Tensor],
        speed_bound: Callable[[Tensor, Tensor, Tensor], Tensor],
        times: Tensor,
        *,
        count: int,
    ):
        self._position, self._speed_bound = position, speed_bound
        self.shape, self.breaks = _times(times, torch.Size([count]), None)

    def position(self, row: Tensor, t: Tensor) -> Tensor:
        """(M, n) joint values."""
        q = self._position(row, t).detach().double()
        return _answer("position", q, row, t, q.isfinite())

    def speed(self, row: Tensor, t0: Tensor, t1: Tensor) -> Tensor:
        """(M, n) bounds on the absolute speeds."""
        qd = self._speed_bound(row, t0, t1).detach().double()
        return _answer("speed_bound", qd, row, t0, qd.isfinite() & (qd >= 0))


class SampledMotion:
    """Motions known at sampled times alone, with a bound on their speed between them.

    Nothing is assumed about the way between two samples but the speed; where that proves nothing, the verdict is
    neither free nor touching. Straight lines between samples are a `PolynomialMotion` of degree 1.

    Args:
        times: (k,) or (..., k) increasing sample times [s].
        q: (..., k, n) joint values.
        max_speed: (n,) or (..., n) largest absolute joint speeds.

    Raises:
        ShapeError: a shape does not fit.
        ConfigError: times do not increase, something is not finite, or a speed is negative.
    """

    continuous = False

    def __init__(self, times: Tensor, q: Tensor, max_speed: Tensor):
        check_tensor("q", q, "(..., k, n)", isinstance(q, Tensor) and q.ndim >= 2)
        check_finite("q", q)
        self.shape, self.breaks = _times(times, q.shape[:-2], q.shape[-2])
        good = isinstance(max_speed, Tensor) and max_speed.ndim >= 1 and max_speed.shape[-1] == q.shape[-1]
        check_tensor("max_speed", max_speed, f"(..., {q.shape[-1]})", good)
        check_finite("max_speed", max_speed)
        check_bound("max_speed", max_speed, "must not be negative", max_speed < 0)
        self._q = q.detach().double().expand(*self.shape, *q.shape[-2:]).reshape(-1, *q.shape[-2:])
        self._speed = max_speed.detach().double().expand(*self.shape, q.shape[-1]).reshape(-1, q.shape[-1])

    def position(self, row: Tensor, t: Tensor) -> Tensor:
        """(M, n) joint values at sample times."""
        return self._q[row, torch.searchsorted(self.breaks[row], t[:, None])[:, 0]]

    def speed(self, row: Tensor, t0: Tensor, t1: Tensor) -> Tensor:
        """(M, n) bounds on the absolute speeds."""
        return self._speed[row]


def _times(times: Tensor, batch: torch.Size, count: int | None) -> tuple[torch.Size, Tensor]:
    """The batch shape and (B, k) break times."""
    good = isinstance(times, Tensor) and times.ndim >= 1 and times.shape[-1] >= 2
    good = good and (count is None or times.shape[-1] == count)
    check_tensor("times", times, f"(..., {'k >= 2' if count is None else count})", good)
    check_finite("times", times)
    try:
        shape = torch.broadcast_shapes(times.shape[:-1], batch)
    except RuntimeError as error:
        raise ShapeError(f"times of shape {tuple(times.shape)} do not fit motions of shape {tuple(batch)}") from error
    late = torch.cat([torch.zeros_like(times[..., :1], dtype=torch.bool), times.diff(dim=-1) <= 0], dim=-1)
    check_bound("times", times, "must increase", late)
    return shape, times.detach().double().expand(*shape, -1).reshape(-1, times.shape[-1])


def _answer(name: str, value: Tensor, row: Tensor, t: Tensor, good: Tensor) -> Tensor:
    """Refuse what a caller's function must not return."""
    if value.ndim != 2 or len(value) != len(row):
        raise ShapeError(f"{name} must return (M, n) for M = {len(row)}, got {tuple(value.shape)}")
    bad = torch.nonzero(~good.all(dim=-1)).flatten()
    if len(bad):
        i = int(bad[0])
        raise ConfigError(f"{name} of motion {int(row[i])} at t = {t[i].item():g} is {value[i].tolist()}")
    return value


def _horner(coefficients: Tensor, s: Tensor) -> Tensor:
    """(M, n) values of (M, d + 1, n) polynomials at (M,)."""
    value = coefficients[:, -1]
    for i in range(coefficients.shape[1] - 2, -1, -1):
        value = value * s[:, None] + coefficients[:, i]
    return value
