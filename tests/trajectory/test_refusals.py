"""Bad input: one clear error each, saying which entry."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import pytest
import torch
from trajectory_cases import KINDS, random_points, random_times

import ikgrad as ik

TIMES = [0.0, 1.0, 2.0, 3.0]


def build(points: Any = None, times: Any = None, **options: Any) -> ik.Trajectory:
    return ik.via_point_trajectory(
        random_points(2, 4, 3) if points is None else points, TIMES if times is None else times, **options
    )


def with_nan(shape: tuple[int, ...], index: tuple[int, ...], value: float = math.nan) -> torch.Tensor:
    points = random_points(*shape)
    points[index] = value
    return points


BUILD_ERRORS: list[tuple[dict[str, Any], type[Exception], str]] = [
    (dict(points=[[0.0], [1.0]]), ik.ShapeError, "points must be a floating-point tensor, got list"),
    (
        dict(points=torch.zeros(4, 3, dtype=torch.int64)),
        ik.ShapeError,
        "points must be a floating-point tensor, got torch.int64",
    ),
    (dict(points=torch.zeros(4)), ik.ShapeError, "points must have shape (..., points, joints), got (4,)"),
    (dict(points=torch.zeros(5, 1, 3)), ik.ShapeError, "a trajectory needs at least two points, got shape (5, 1, 3)"),
    (dict(points=torch.zeros(0, 3)), ik.ShapeError, "a trajectory needs at least two points, got shape (0, 3)"),
    (dict(points=torch.zeros(4, 0)), ik.ShapeError, "points must have at least one joint, got shape (4, 0)"),
    (dict(points=with_nan((2, 4, 3), (1, 2, 0))), ik.ConfigError, "points[1, 2, 0] must be finite, got nan"),
    (dict(points=with_nan((4, 3), (3, 1), math.inf)), ik.ConfigError, "points[3, 1] must be finite, got inf"),
    (dict(times=[0.0, 1.0, 2.0]), ik.ShapeError, "times must have shape (..., 4), one time a point, got (3,)"),
    (dict(times=1.0), ik.ShapeError, "times must have shape (..., 4), one time a point, got ()"),
    (dict(times="soon"), ik.ShapeError, "times must be a tensor or numbers, got str"),
    (dict(times=random_times(5, 4)), ik.ShapeError, "batch (5,) of times does not fit batch (2,)"),
    (dict(times=[0.0, 1.0, math.nan, 3.0]), ik.ConfigError, "times[2] must be finite, got nan"),
    (dict(times=[0.0, 1.0, 2.0, math.inf]), ik.ConfigError, "times[3] must be finite, got inf"),
    (dict(times=[0.0, 2.0, 1.0, 3.0]), ik.ConfigError, "times must rise: times[2] = 1 does not come after 2"),
    (dict(times=[0.0, 1.0, 1.0, 3.0]), ik.ConfigError, "times must rise: times[2] = 1 does not come after 1"),
    (
        dict(times=torch.tensor([TIMES, [0.0, 1.0, 2.5, 2.5]])),
        ik.ConfigError,
        "times must rise: times[1, 3] = 2.5 does not come after 2.5",
    ),
    (
        dict(kind="4-3-5"),
        ik.UnknownNameError,
        "unknown trajectory kind '4-3-5'; did you mean '4-3-4'? (known: 4-3-4, 3-5-3, cubic, quintic)",
    ),
    (
        dict(points=random_points(3, 2), times=[0, 1, 2], kind="3-5-3"),
        ik.ConfigError,
        "kind '3-5-3' needs at least 4 points, got 3; take '4-3-4'",
    ),
    (
        dict(start_velocity=[0.0, 0.0]),
        ik.ShapeError,
        "start_velocity must be a number or have shape (..., 3), got (2,)",
    ),
    (dict(end_velocity=torch.zeros(5, 3)), ik.ShapeError, "batch (5,) of end_velocity does not fit batch (2,)"),
    (dict(start_acceleration=[0.0, math.nan, 0.0]), ik.ConfigError, "start_acceleration[1] must be finite, got nan"),
    (dict(end_acceleration=math.inf), ik.ConfigError, "end_acceleration must be finite, got inf"),
    (
        dict(kind="cubic", end_velocity=0.0, end_acceleration=0.0),
        ik.ConfigError,
        "one condition at each end: give end_velocity or end_acceleration, or take kind '4-3-4'",
    ),
]


@pytest.mark.parametrize(("options", "kind", "text"), BUILD_ERRORS, ids=[text for *_, text in BUILD_ERRORS])
def test_bad_questions_are_refused(options: dict[str, Any], kind: type[Exception], text: str):
    with pytest.raises(kind, match=re.escape(text)):
        build(**options)


USE_ERRORS: list[tuple[Callable[[ik.Trajectory], Any], type[Exception], str]] = [
    (lambda x: x.position(3.5), ik.ConfigError, "t = 3.5 lies outside the trajectory, 0 to 3 s"),
    (lambda x: x.velocity([0.0, 1.0, -0.25]), ik.ConfigError, "t[2] = -0.25 lies outside the trajectory, 0 to 3 s"),
    (
        lambda x: x.jerk(torch.tensor([[0.0, 1.0], [2.0, 4.0]])),
        ik.ConfigError,
        "t[1, 1] = 4 lies outside the trajectory, 0 to 3 s",
    ),
    (lambda x: x.position(math.nan), ik.ConfigError, "t = nan lies outside"),
    (lambda x: x.position([0.0, math.nan]), ik.ConfigError, "t[1] = nan lies outside"),
    (lambda x: x.position(torch.zeros(5, 2)), ik.ShapeError, "batch (5,) of t does not fit batch (2,)"),
    (lambda x: x.position("now"), ik.ShapeError, "t must be a tensor or numbers, got str"),
    (lambda x: x(0.0, derivative=-1), ik.ConfigError, "derivative must not be negative, got -1"),
    (lambda x: x.peak(derivative=-1), ik.ConfigError, "derivative must not be negative, got -1"),
    (lambda x: x.scaled(0.0), ik.ConfigError, "factor must be positive and finite, got 0"),
    (lambda x: x.scaled([1.0, math.inf]), ik.ConfigError, "factor[1] must be positive and finite, got inf"),
    (lambda x: x.scaled([1.0, 1.0, 1.0]), ik.ShapeError, "batch (3,) of factor does not fit batch (2,)"),
    (lambda x: x.scaled_to(), ik.ConfigError, "give velocity_max, acceleration_max or jerk_max"),
    (lambda x: x.scaled_to(velocity_max=0.0), ik.ConfigError, "velocity_max must be positive, got 0"),
    (lambda x: x.scaled_to(velocity_max=math.nan), ik.ConfigError, "velocity_max must be positive, got nan"),
    (
        lambda x: x.scaled_to(acceleration_max=[1.0, 2.0, -1.0]),
        ik.ConfigError,
        "acceleration_max[2] must be positive, got -1",
    ),
    (
        lambda x: x.scaled_to(jerk_max=[1.0, 2.0]),
        ik.ShapeError,
        "jerk_max must be a number or have shape (..., 3), got (2,)",
    ),
    (
        lambda x: x.stretch_to(velocity_max=torch.ones(4, 3)),
        ik.ShapeError,
        "batch (4,) of velocity_max does not fit batch (2,)",
    ),
]


@pytest.mark.parametrize(("use", "kind", "text"), USE_ERRORS, ids=[text for *_, text in USE_ERRORS])
def test_bad_uses_are_refused(use: Callable[[ik.Trajectory], Any], kind: type[Exception], text: str):
    trajectory = build()
    with pytest.raises(kind, match=re.escape(text)):
        use(trajectory)


def test_a_time_outside_its_own_trajectory_is_named():
    trajectory = build(times=torch.tensor([TIMES, [0.0, 1.0, 2.0, 2.5]]))
    with pytest.raises(ik.ConfigError, match=r"t\[1, 0\] = 2.75 lies outside the trajectory, 0 to 2.5 s"):
        trajectory.position(torch.tensor([[2.75], [2.75]]))
    with pytest.raises(ik.ConfigError, match=r"t\[1, 1\] = 2.75 lies outside the trajectory, 0 to 2.5 s"):
        trajectory.position([0.0, 2.75])  # shared times have to fit every trajectory
    assert trajectory.position(torch.tensor([[2.75], [2.25]])).shape == (2, 1, 3)


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_batch_is_no_error(kind: str):
    trajectory = build(points=torch.zeros(0, 4, 3, dtype=torch.float64), kind=kind)
    assert trajectory.position([0.0, 3.0]).shape == (0, 2, 3)
    assert trajectory.peak().shape == (0, 3)
    assert trajectory.scaled_to(velocity_max=1.0).duration.shape == (0,)
