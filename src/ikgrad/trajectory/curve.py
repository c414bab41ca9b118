"""A trajectory: polynomials between break times, their derivatives, extremes and time scaling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.trajectory.checks import Numbers, as_numbers, check_derivative, check_inside, check_limit, entry, fit
from ikgrad.trajectory.extremes import derivative as slope
from ikgrad.trajectory.extremes import extremes


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint trajectories as piecewise polynomials, one or a batch of them; made by `via_point_trajectory`.

    ``q(t) = sum_i coefficients[..., k, i, :] s^i`` with s = t - times[k] inside segment k. At a break the segment that
    begins there counts, which matters for the jerk alone.

    Attributes:
        times: (S + 1,) break times of all trajectories, or (..., S + 1) [s].
        coefficients: (..., S, d + 1, n) in ascending powers of s; lower degrees are filled up with zeros.
    """

    times: Tensor
    coefficients: Tensor

    @property
    def duration(self) -> Tensor:
        """() or (...) from the first to the last break [s]."""
        return self.times[..., -1] - self.times[..., 0]

    @property
    def batch_shape(self) -> torch.Size:
        """Batch dimensions, () for a single trajectory."""
        return torch.broadcast_shapes(self.times.shape[:-1], self.coefficients.shape[:-3])

    def position(self, t: Numbers) -> Tensor:
        """Joint values at times; see `__call__`."""
        return self(t)

    def velocity(self, t: Numbers) -> Tensor:
        """First derivatives at times; see `__call__`."""
        return self(t, derivative=1)

    def acceleration(self, t: Numbers) -> Tensor:
        """Second derivatives at times; see `__call__`."""
        return self(t, derivative=2)

    def jerk(self, t: Numbers) -> Tensor:
        """Third derivatives at times; see `__call__`."""
        return self(t, derivative=3)

    def __call__(self, t: Numbers, *, derivative: int = 0) -> Tensor:
        """Values or derivatives at any times inside the trajectory, differentiable.

        A time that is outside by rounding (a few units in the last place of ``t``) is taken inside by the end segment.

        Args:
            t: one time, (T,) times for all trajectories, or (..., T) with the batch in front [s]. For one time a
                trajectory use (..., 1).
            derivative: 0 for the position, 1 for the velocity, ...

        Returns:
            (..., n) for one time, else (..., T, n).

        Raises:
            ShapeError: the batch of ``t`` does not fit.
            ConfigError: a time lies outside or is not a number.

        Example:
            >>> import ikgrad as ik, torch
            >>> trajectory = ik.via_point_trajectory(torch.rand(5, 4, 6), [0.0, 1.0, 2.0, 3.0])
            >>> trajectory.position(torch.linspace(0, 3, 50)).shape
            torch.Size([5, 50, 6])
        """
        check_derivative(derivative)
        given = as_numbers("t", t, self.times)
        fit("t", given.shape[:-1], self.batch_shape)
        coarse = t.dtype if isinstance(t, Tensor) and t.is_floating_point() else given.dtype
        eps = max(torch.finfo(coarse).eps, torch.finfo(given.dtype).eps)
        check_inside(given, self.times, eps)
        value = self._evaluate(given if given.ndim else given[None], derivative)
        return value if given.ndim else value[..., 0, :]

    def extremes(self, *, derivative: int = 0) -> tuple[Tensor, Tensor]:
        """Smallest and largest value of every joint over the whole time, exact to rounding, differentiable once.

        Args:
            derivative: of the position, the velocity (1), ...

        Returns:
            (..., n) and (..., n)

        Example:
            >>> import ikgrad as ik, torch
            >>> points = torch.tensor([[0.0], [1.0], [0.0]], dtype=torch.float64)
            >>> low, high = ik.via_point_trajectory(points, [0.0, 1.0, 3.0]).extremes()
            >>> bool(high > 1.01)  # it overshoots
            True
        """
        check_derivative(derivative)
        h = self.times.diff(dim=-1).double()
        powers = torch.arange(self.coefficients.shape[-2], device=h.device)
        unit = self.coefficients.double() * (h[..., None] ** powers)[..., None]  # (..., S, d + 1, n) in u = s / h
        polynomials = unit.mT  # (..., S, n, d + 1)
        for _ in range(derivative):
            polynomials = slope(polynomials) if polynomials.shape[-1] > 1 else torch.zeros_like(polynomials)
        low, high = (value / h[..., None] ** derivative for value in extremes(polynomials))
        return low.amin(dim=-2).to(self.coefficients.dtype), high.amax(dim=-2).to(self.coefficients.dtype)

    def peak(self, *, derivative: int = 1) -> Tensor:
        """(..., n) largest size of a derivative over the whole time, exact to rounding; see `extremes`."""
        low, high = self.extremes(derivative=derivative)
        return torch.maximum(-low, high)

    def stretch_to(
        self,
        *,
        velocity_max: Numbers | None = None,
        acceleration_max: Numbers | None = None,
        jerk_max: Numbers | None = None,
    ) -> Tensor:
        """The factor on all durations with which the most demanding joint is just at its limit.

        ``max over joints of (peak velocity / limit), (peak acceleration / limit)^(1/2), (peak jerk / limit)^(1/3)``:
        above 1 for a trajectory that is too fast, 0 for one that stands still.

        Args:
            velocity_max: a number for all joints, or (..., n), positive; infinity is no limit [rad/s or m/s].
            acceleration_max: the same for the acceleration.
            jerk_max: the same for the jerk.

        Returns:
            (...) factors.
        """
        limits = {
            1: ("velocity_max", velocity_max),
            2: ("acceleration_max", acceleration_max),
            3: ("jerk_max", jerk_max),
        }
        if all(value is None for _, value in limits.values()):
            raise ConfigError("give velocity_max, acceleration_max or jerk_max")
        shape = (*self.batch_shape, self.coefficients.shape[-1])
        ratios = []
        for order, (name, value) in limits.items():
            if value is not None:
                limit = check_limit(name, value, shape, self.coefficients)
                ratio = (self.peak(derivative=order) / limit).amax(dim=-1)
                ratios.append(_root(ratio, order))
        return torch.stack(torch.broadcast_tensors(*ratios)).amax(dim=0)

    def scaled(self, factor: Numbers) -> Trajectory:
        """The same path with all durations times a factor; it begins at the same time.

        Velocities are divided by the factor, also those at the ends, accelerations by its square.

        Args:
            factor: a number, or (...) one a trajectory, positive.
        """
        given = as_numbers("factor", factor, self.times)
        fit("factor", given.shape, self.batch_shape)
        bad = ~((given > 0) & given.isfinite())
        if bool(bad.any()):
            raise ConfigError(f"{entry('factor', bad)} must be positive and finite, got {given[bad][0].item():g}")
        start = self.times[..., :1]
        powers = torch.arange(self.coefficients.shape[-2], device=given.device)
        return Trajectory(
            times=start + given[..., None] * (self.times - start),
            coefficients=self.coefficients / (given[..., None, None] ** powers)[..., None],
        )

    def scaled_to(
        self,
        *,
        velocity_max: Numbers | None = None,
        acceleration_max: Numbers | None = None,
        jerk_max: Numbers | None = None,
    ) -> Trajectory:
        """The same path, slowed down evenly until every joint keeps its limits; never made faster.

        Each trajectory of a batch is slowed down by itself, as far as its exact peaks ask for. Velocities and
        accelerations given at the ends shrink with the rest. To use the limits up, take
        ``trajectory.scaled(trajectory.stretch_to(...))``.

        Args:
            velocity_max: a number for all joints, or (..., n), positive; infinity is no limit [rad/s or m/s].
            acceleration_max: the same for the acceleration.
            jerk_max: the same for the jerk.

        Raises:
            ShapeError: a limit does not fit.
            ConfigError: a limit is not positive, or none is given.

        Example:
            >>> import ikgrad as ik, torch
            >>> points = torch.tensor([[0.0], [1.0]], dtype=torch.float64)
            >>> trajectory = ik.via_point_trajectory(points, [0.0, 1.0]).scaled_to(velocity_max=0.5)
            >>> trajectory.duration, trajectory.peak()
            (tensor(3.7500, dtype=torch.float64), tensor([0.5000], dtype=torch.float64))
        """
        factor = self.stretch_to(velocity_max=velocity_max, acceleration_max=acceleration_max, jerk_max=jerk_max)
        return self.scaled(factor.clamp(min=1.0))

    def _evaluate(self, t: Tensor, derivative: int) -> Tensor:
        """(..., T, n); ``t`` is (..., T)."""
        segments, terms, n = self.coefficients.shape[-3:]
        if derivative >= terms:
            return torch.zeros_like(self._evaluate(t, 0))
        segment, s = self._locate(t)
        powers = _powers(s, terms, derivative)  # (..., T, d + 1)
        if segment.ndim == 1:  # same segments for all: one small matrix, whatever the batch
            chosen = torch.nn.functional.one_hot(segment, segments).to(powers)
            weights = (chosen[:, :, None] * powers[:, None, :]).flatten(1)  # (T, S (d + 1))
            return torch.einsum("tk,...kn->...tn", weights, self.coefficients.flatten(-3, -2))
        batch = torch.broadcast_shapes(segment.shape[:-1], self.batch_shape)
        rows = self.coefficients.expand(*batch, segments, terms, n).reshape(-1, terms * n)
        first = segments * torch.arange(batch.numel(), device=t.device).reshape(*batch, 1)
        chosen = rows[(first + segment).flatten()].unflatten(-1, (terms, n))  # (... T, d + 1, n)
        powers = powers.expand(*batch, *powers.shape[-2:]).reshape(-1, 1, terms)
        return (powers @ chosen).reshape(*batch, segment.shape[-1], n)

    def _locate(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Number of the segment and local time, both (..., T)."""
        times, inner = self.times, self.times[..., 1:-1].detach()
        if times.ndim == 1:
            segment = torch.searchsorted(inner.contiguous(), t.detach().contiguous(), right=True)
            return segment, t - times[segment]
        batch = torch.broadcast_shapes(times.shape[:-1], t.shape[:-1])
        t = t.expand(*batch, t.shape[-1])
        inner = inner.expand(*batch, inner.shape[-1]).contiguous()
        segment = torch.searchsorted(inner, t.detach().contiguous(), right=True)
        return segment, t - times.expand(*batch, times.shape[-1]).gather(-1, segment)


def _powers(s: Tensor, terms: int, derivative: int) -> Tensor:
    """(..., terms): the derivative of 1, s, s^2, ..."""
    columns = [torch.zeros_like(s)] * derivative
    power = torch.ones_like(s)
    for i in range(derivative, terms):
        columns.append(math.perm(i, derivative) * power)
        power = power * s
    return torch.stack(columns, dim=-1)


def _root(ratio: Tensor, order: int) -> Tensor:
    """ratio^(1/order), with gradient 0 instead of infinity for a trajectory that stands still."""
    safe = torch.where(ratio > 0, ratio, torch.ones_like(ratio))
    return torch.where(ratio > 0, safe ** (1 / order), torch.zeros_like(ratio))
