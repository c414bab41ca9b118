"""What every trajectory promises: its points, its smoothness, its ends, and rows that do not know of each other."""

from __future__ import annotations

import math

import pytest
import torch
from trajectory_cases import CASES, KINDS, ends_for, inside, left_limit, random_points, random_times

import ikgrad as ik

SHAPES = [(), (1,), (3, 1, 2), (0,)]
every_case = pytest.mark.parametrize(("kind", "m"), CASES)


@every_case
@pytest.mark.parametrize("seed", [0, 1])
def test_the_points_are_met_and_velocity_and_acceleration_are_continuous(kind: str, m: int, seed: int):
    points, times = random_points(5, m, 3, seed=seed), random_times(m, seed=seed)
    trajectory = ik.via_point_trajectory(points, times, kind=kind, **ends_for(kind))
    torch.testing.assert_close(trajectory.position(times), points, rtol=0, atol=1e-9)
    for derivative, bar in ((0, 1e-9), (1, 1e-8), (2, 1e-8)):
        before = left_limit(trajectory.coefficients, times.diff(), derivative)[..., :-1, :]
        after = trajectory(times[1:-1], derivative=derivative)
        torch.testing.assert_close(before, after, rtol=0, atol=bar)


@every_case
def test_derivatives_at_the_ends_are_the_given_ones(kind: str, m: int):
    points, times = random_points(5, m, 3), random_times(m)
    ends = ends_for(kind)
    trajectory = ik.via_point_trajectory(points, times, kind=kind, **ends)
    for name, value in ends.items():
        side, quantity = name.split("_")
        found = getattr(trajectory, quantity)(times[0 if side == "start" else -1])
        torch.testing.assert_close(found, torch.full_like(found, value), rtol=0, atol=1e-9)


@every_case
def test_nothing_given_is_from_rest_to_rest(kind: str, m: int):
    points, times = random_points(m, 3), random_times(m)
    trajectory = ik.via_point_trajectory(points, times, kind=kind)
    orders = (1,) if kind == "cubic" else (1, 2)
    assert all(float(trajectory(times[[0, -1]], derivative=d).abs().max()) < 1e-10 for d in orders)


@pytest.mark.parametrize(
    ("kind", "degrees"),
    [
        ("4-3-4", [(5,), (4, 4), (4, 3, 4), (4, 3, 3, 4)]),
        ("3-5-3", [None, None, (3, 5, 3), (3, 5, 5, 3)]),
        ("cubic", [(3,), (3, 3), (3, 3, 3), (3, 3, 3, 3)]),
        ("quintic", [(5,), (5, 5), (5, 5, 5), (5, 5, 5, 5)]),
    ],
)
def test_segments_have_the_degrees_in_the_name(kind: str, degrees: list[tuple[int, ...] | None]):
    for m, wanted in enumerate(degrees, start=2):
        if wanted is not None:
            trajectory = ik.via_point_trajectory(random_points(m, 2), random_times(m), kind=kind)
            used = trajectory.coefficients.abs().amax(dim=-1) > 0
            assert [int(row.nonzero().max()) for row in used] == list(wanted)
            assert trajectory.coefficients.shape == (m - 1, max(wanted) + 1, 2)


@pytest.mark.parametrize("kind", ["quintic", "3-5-3"])
def test_jerk_and_snap_are_continuous_between_quintics(kind: str):
    points, times = random_points(6, 2), random_times(6)
    trajectory = ik.via_point_trajectory(points, times, kind=kind)
    between = slice(None) if kind == "quintic" else slice(1, -1)
    for derivative in (3, 4):
        before = left_limit(trajectory.coefficients, times.diff(), derivative)[:-1]
        after = trajectory(times[1:-1], derivative=derivative)
        torch.testing.assert_close(before[between], after[between], rtol=1e-9, atol=1e-8)


def test_the_middle_piece_of_3_5_3_is_decided_by_the_pieces_at_the_ends():
    """A cubic is determined by the rest at its outer end and its two points, so each end knows nothing of the other."""
    points, times = random_points(4, 2), random_times(4)
    moved = points.clone()
    moved[3] += 1.0
    a, b = (ik.via_point_trajectory(p, times, kind="3-5-3").coefficients for p in (points, moved))
    torch.testing.assert_close(a[0], b[0], rtol=0, atol=1e-12)
    a, b = (ik.via_point_trajectory(p, times, kind="4-3-4").coefficients for p in (points, moved))
    assert float((a[0] - b[0]).abs().max()) > 1e-3  # the paper's point: there the whole curve changes


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("own_times", [False, True])
def test_batched_equals_looped_and_inputs_are_not_modified(kind: str, shape: tuple[int, ...], own_times: bool):
    points = random_points(*shape, 5, 2)
    times = random_times(*shape, 5) if own_times else random_times(5)
    velocity = random_points(*shape, 2, seed=7)
    before = [x.clone() for x in (points, times, velocity)]
    batched = ik.via_point_trajectory(points, times, kind=kind, start_velocity=velocity)
    t = inside(times, 6)
    for derivative in range(4):
        found = batched(t, derivative=derivative)
        assert found.shape == (*shape, 6, 2)
        for i in range(math.prod(shape)):
            row = [x.reshape(-1, *x.shape[len(shape) :])[i] for x in (points, velocity, found)]
            own = [x.reshape(-1, x.shape[-1])[i] if own_times else x for x in (times, t)]
            single = ik.via_point_trajectory(row[0], own[0], kind=kind, start_velocity=row[1])
            torch.testing.assert_close(single(own[1], derivative=derivative), row[2], rtol=1e-10, atol=1e-10)
    assert all(torch.equal(x, y) for x, y in zip(before, (points, times, velocity), strict=True))


def test_batches_of_all_arguments_broadcast():
    points, times, velocity = random_points(4, 1, 3, 2), random_times(5, 3), random_points(2, seed=1)
    trajectory = ik.via_point_trajectory(points, times, end_velocity=velocity)
    assert trajectory.batch_shape == (4, 5)
    assert trajectory.duration.shape == (5,)
    t = inside(times, 7)
    assert trajectory.position(t).shape == (4, 5, 7, 2)
    alone = ik.via_point_trajectory(points[2, 0], times[3], end_velocity=velocity)
    torch.testing.assert_close(trajectory.position(t)[2, 3], alone.position(t[3]), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_backwards_in_time_is_the_same_curve(kind: str):
    points, times = random_points(6, 2), random_times(6)
    forth = ik.via_point_trajectory(points, times, kind=kind)
    back = ik.via_point_trajectory(points.flip(0), -times.flip(0), kind=kind)
    t = inside(times, 50)
    torch.testing.assert_close(forth.position(t), back.position(-t), rtol=0, atol=1e-10)
    torch.testing.assert_close(forth.velocity(t), -back.velocity(-t), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_the_unit_of_time_does_not_matter(kind: str, unit: float):
    points, times = random_points(6, 2), random_times(6)
    one = ik.via_point_trajectory(points, times, kind=kind)
    other = ik.via_point_trajectory(points, unit * times, kind=kind)
    t = inside(times, 50)
    torch.testing.assert_close(one.position(t), other.position(unit * t), rtol=0, atol=1e-10)
    torch.testing.assert_close(one.jerk(t), other.jerk(unit * t) * unit**3, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_single_precision_is_solved_in_double_and_returned_in_single(kind: str):
    points, times = random_points(4, 6, 2).float(), random_times(6).float()
    trajectory = ik.via_point_trajectory(points, times, kind=kind)
    assert trajectory.times.dtype == trajectory.coefficients.dtype == trajectory.position(times).dtype == torch.float32
    double = ik.via_point_trajectory(points.double(), times.double(), kind=kind)
    torch.testing.assert_close(trajectory.coefficients, double.coefficients.float(), rtol=0, atol=0)


def test_a_thousand_points_are_met():
    points, times = random_points(1000, 2), random_times(1000)
    for kind in ("4-3-4", "quintic"):
        trajectory = ik.via_point_trajectory(points, times, kind=kind)
        torch.testing.assert_close(trajectory.position(times), points, rtol=0, atol=1e-9)
        before = left_limit(trajectory.coefficients, times.diff(), 2)[:-1]
        torch.testing.assert_close(before, trajectory.acceleration(times[1:-1]), rtol=1e-11, atol=1e-8)
