"""Where bad input to trajectories is refused; every message names the entry."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError

Numbers = Tensor | float | Sequence[float]


def entry(name: str, bad: Tensor, *, shift: int = 0) -> str:
    """``name[2, 0]``: the first True of ``bad``; ``shift`` is added to its last index."""
    index = torch.nonzero(bad)[0].tolist()
    if index:
        index[-1] += shift
    return f"{name}[{', '.join(map(str, index))}]" if index else name


def check_finite(name: str, value: Tensor) -> None:
    """Refuse NaN and infinity."""
    bad = ~value.isfinite()
    if bool(bad.any()):
        raise ConfigError(f"{entry(name, bad)} must be finite, got {value[bad][0].item()}")


def check_points(points: Tensor) -> None:
    """Refuse via points that are no (..., m, n) tensor with m >= 2."""
    if not isinstance(points, Tensor) or not points.is_floating_point():
        got = points.dtype if isinstance(points, Tensor) else type(points).__name__
        raise ShapeError(f"points must be a floating-point tensor, got {got}")
    if points.ndim < 2:
        raise ShapeError(f"points must have shape (..., points, joints), got {tuple(points.shape)}")
    if points.shape[-2] < 2:
        raise ShapeError(f"a trajectory needs at least two points, got shape {tuple(points.shape)}")
    if points.shape[-1] < 1:
        raise ShapeError(f"points must have at least one joint, got shape {tuple(points.shape)}")
    check_finite("points", points)


def check_times(times: Numbers, points: Tensor) -> Tensor:
    """(..., m) via times like ``points``; refuses what does not rise or does not fit."""
    given = as_numbers("times", times, points)
    m = points.shape[-2]
    if given.ndim == 0 or given.shape[-1] != m:
        raise ShapeError(f"times must have shape (..., {m}), one time a point, got {tuple(given.shape)}")
    fit("times", given.shape[:-1], points.shape[:-2])
    check_finite("times", given)
    early = given.diff(dim=-1) <= 0
    if bool(early.any()):
        now, before = given[..., 1:][early][0].item(), given[..., :-1][early][0].item()
        raise ConfigError(f"times must rise: {entry('times', early, shift=1)} = {now:g} does not come after {before:g}")
    return given


def check_end(name: str, value: Numbers, points: Tensor) -> Tensor:
    """(..., n) derivative at an end, like ``points``; a number counts for all joints."""
    n = points.shape[-1]
    given = as_numbers(name, value, points)
    if given.ndim and given.shape[-1] != n:
        raise ShapeError(f"{name} must be a number or have shape (..., {n}), got {tuple(given.shape)}")
    fit(name, given.shape[:-1], points.shape[:-2])
    check_finite(name, given)
    return given.expand(n) if given.ndim == 0 else given


def check_limit(name: str, value: Numbers, shape: Sequence[int], like: Tensor) -> Tensor:
    """A limit that fits ``shape``, (..., n); infinity is no limit."""
    given = as_numbers(name, value, like)
    if given.ndim and given.shape[-1] != shape[-1]:
        raise ShapeError(f"{name} must be a number or have shape (..., {shape[-1]}), got {tuple(given.shape)}")
    fit(name, given.shape[:-1], shape[:-1])
    bad = ~(given > 0)
    if bool(bad.any()):
        raise ConfigError(f"{entry(name, bad)} must be positive, got {given[bad][0].item():g}")
    return given


def check_derivative(order: int) -> None:
    """Refuse a negative order."""
    if order < 0:
        raise ConfigError(f"derivative must not be negative, got {order}")


def check_inside(t: Tensor, times: Tensor, eps: float) -> None:
    """Refuse times (..., T), or one, outside the first and last of ``times`` by more than a few roundings."""
    start, end = (times[..., :1], times[..., -1:]) if t.ndim else (times[..., 0], times[..., -1])
    slack = 4 * eps * torch.maximum(start.abs(), end.abs())
    bad = ~((t >= start - slack) & (t <= end + slack))
    if bool(bad.any()):
        now, first, last = (value.expand_as(bad)[bad][0].item() for value in (t, start, end))
        name = entry("t", bad) if t.ndim else "t"
        raise ConfigError(f"{name} = {now:g} lies outside the trajectory, {first:g} to {last:g} s")


def as_numbers(name: str, value: Numbers, like: Tensor) -> Tensor:
    """The value as a tensor of the dtype and on the device of ``like``."""
    try:
        return torch.as_tensor(value, dtype=like.dtype, device=like.device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ShapeError(f"{name} must be a tensor or numbers, got {type(value).__name__}: {error}") from error


def fit(name: str, shape: Sequence[int], batch: Sequence[int]) -> None:
    """Refuse batch dimensions that do not broadcast."""
    try:
        torch.broadcast_shapes(tuple(shape), tuple(batch))
    except RuntimeError as error:
        raise ShapeError(f"batch {tuple(shape)} of {name} does not fit batch {tuple(batch)}") from error
