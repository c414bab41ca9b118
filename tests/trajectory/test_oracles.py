"""Against scipy's splines, and against what is known of each kind in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.interpolate import BPoly, CubicSpline, PPoly, make_interp_spline
from torch import Tensor
from trajectory_cases import CASES, KINDS, ends_for, inside, random_points, random_times

import ikgrad as ik


def assert_same(trajectory: ik.Trajectory, spline: object, times: Tensor, derivatives: int = 4) -> None:
    """1e-9 of each derivative's own size; scipy and we round differently."""
    t = inside(times, 200)
    for d in range(derivatives):
        ours, theirs = trajectory(t, derivative=d), torch.from_numpy(np.asarray(spline(t.numpy(), d)))  # type: ignore[operator]
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-9 * max(1.0, float(theirs.abs().max())))


@pytest.mark.parametrize("m", [2, 3, 4, 8, 50])
@pytest.mark.parametrize(("start", "end"), [(1, 1), (1, 2), (2, 1), (2, 2)])
@pytest.mark.parametrize("value", [0.0, 0.7])
def test_cubic_is_scipys_cubic_spline(m: int, start: int, end: int, value: float):
    """Clamped (1, 0.0), natural (2, 0.0), and mixed ends."""
    points, times = random_points(m, 3), random_times(m)
    name = {1: "velocity", 2: "acceleration"}
    ends = {f"start_{name[start]}": value, f"end_{name[end]}": -value}
    ours = ik.via_point_trajectory(points, times, kind="cubic", **ends)
    conditions = [(order, np.full(3, v)) for order, v in ((start, value), (end, -value))]
    assert_same(ours, CubicSpline(times.numpy(), points.numpy(), bc_type=tuple(conditions)), times)


@pytest.mark.parametrize("m", [2, 3, 4, 8, 50])
def test_quintic_is_scipys_spline_of_degree_5(m: int):
    points, times = random_points(m, 3), random_times(m)
    ours = ik.via_point_trajectory(points, times, kind="quintic", **ends_for("quintic"))
    start = [(1, np.full(3, 0.3)), (2, np.full(3, 0.5))]
    end = [(1, np.full(3, -0.4)), (2, np.full(3, 0.7))]
    assert_same(ours, make_interp_spline(times.numpy(), points.numpy(), k=5, bc_type=(start, end)), times, 6)


@pytest.mark.parametrize("kind", ["4-3-4", "quintic"])
def test_one_segment_is_the_quintic_through_both_ends(kind: str):
    points, times = random_points(2, 1), random_times(2)
    ours = ik.via_point_trajectory(points, times, kind=kind, **ends_for(kind))
    theirs = BPoly.from_derivatives(times.numpy(), [[points[0, 0], 0.3, 0.5], [points[1, 0], -0.4, 0.7]])
    assert_same(ours, lambda t, d: theirs(t, d)[:, None], times, 6)


@pytest.mark.parametrize("m", [3, 4, 8])
def test_4_3_4_with_the_ends_of_a_cubic_spline_is_that_spline(m: int):
    """scipy's not-a-knot spline starts and ends with some velocity and acceleration; no quartic is then needed."""
    points, times = random_points(m, 3), random_times(m)
    spline = CubicSpline(times.numpy(), points.numpy(), bc_type="not-a-knot")
    ends = {
        f"{side}_{name}": torch.from_numpy(spline(float(times[k]), d))
        for side, k in (("start", 0), ("end", -1))
        for name, d in (("velocity", 1), ("acceleration", 2))
    }
    ours = ik.via_point_trajectory(points, times, kind="4-3-4", **ends)
    assert float(ours.coefficients[:, 4:].abs().max()) < 1e-9
    assert_same(ours, spline, times, 3)


@pytest.mark.parametrize(("kind", "m"), CASES)
def test_pieces_are_continuous_for_scipy_too(kind: str, m: int):
    """Built by scipy from the derivatives at the points: two cubic or quintic ends fix what lies between."""
    points, times = random_points(m, 2), random_times(m)
    ours = ik.via_point_trajectory(points, times, kind=kind, **ends_for(kind))
    derivatives = np.stack([ours(times, derivative=d).numpy() for d in range(3)], axis=1)  # (m, 3, n)
    for joint in range(2):
        theirs = BPoly.from_derivatives(times.numpy(), derivatives[..., joint])
        t = inside(times, 100)
        np.testing.assert_allclose(ours.position(t)[:, joint], theirs(t.numpy()), rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_evaluation_is_scipys_piecewise_polynomial(kind: str):
    points, times = random_points(6, 2), random_times(6)
    ours = ik.via_point_trajectory(points, times, kind=kind)
    descending = ours.coefficients.flip(1).transpose(0, 1).numpy()  # (d + 1, S, n)
    assert_same(ours, PPoly(descending, times.numpy()), times, 6)
    at = times[1:-1]  # at a break the later segment counts, in both
    np.testing.assert_allclose(ours.jerk(at), PPoly(descending, times.numpy())(at.numpy(), 3), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("kind", "m"), CASES)
def test_a_polynomial_that_the_kind_contains_comes_back(kind: str, m: int):
    """A cubic is in every kind, a quintic in "quintic"."""
    times = random_times(m)
    curve = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.2] + ([-0.1, 0.03] if kind == "quintic" else []))
    at = {d: torch.from_numpy(curve.deriv(d)(times.numpy()) if d else curve(times.numpy()))[:, None] for d in range(3)}
    ends = {
        f"{side}_{name}": at[d][k]
        for side, k in (("start", 0), ("end", -1))
        for name, d in (("velocity", 1), ("acceleration", 2))
        if kind != "cubic" or d == 1
    }
    trajectory = ik.via_point_trajectory(at[0], times, kind=kind, **ends)
    t = inside(times, 50)
    for d in range(6):
        wanted = (curve.deriv(d) if d else curve)(t.numpy())
        np.testing.assert_allclose(trajectory(t, derivative=d)[:, 0], wanted, rtol=0, atol=1e-7)


def test_segments_of_very_different_duration_keep_their_accuracy():
    """1 to 100; without scaled rows of the system the worst error is 3e-8, with them 3e-10."""
    curve = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.2, -0.1, 0.03])
    worst = 0.0
    for seed in range(20):
        unit = torch.rand(8, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        times = torch.nn.functional.pad((10 ** (2 * unit - 2)).cumsum(0), (1, 0))
        p, v, a = (torch.from_numpy(c(times.numpy()))[:, None] for c in (curve, curve.deriv(1), curve.deriv(2)))
        ends = {"start_velocity": v[0], "end_velocity": v[-1], "start_acceleration": a[0], "end_acceleration": a[-1]}
        found = ik.via_point_trajectory(p, times, kind="quintic", **ends).acceleration(times)
        worst = max(worst, float((found - a).abs().max()))
    assert worst < 3e-9


def integral_of_square(trajectory: ik.Trajectory, derivative: int) -> Tensor:
    """Of a derivative of every joint: eight-point Gauss quadrature a segment is exact up to degree 15."""
    nodes, weights = (torch.from_numpy(x) for x in np.polynomial.legendre.leggauss(8))
    h = trajectory.times.diff()
    t = trajectory.times[:-1, None] + h[:, None] * (nodes + 1) / 2
    squared = trajectory(t.flatten(), derivative=derivative).square().unflatten(-2, t.shape)
    return (squared * (weights[:, None] * h[:, None, None] / 2)).sum(dim=(-3, -2))


@pytest.mark.parametrize(("best", "derivative", "others"), [("cubic", 2, KINDS), ("quintic", 3, ("4-3-4", "3-5-3"))])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_splines_have_the_smallest_integral(best: str, derivative: int, others: tuple[str, ...], seed: int):
    """Of squared acceleration (cubic) and jerk (quintic), among all curves with the same points and ends.

    The others have acceleration 0 at the ends as well; a cubic spline has not, so it is no rival of the quintic.
    """
    points, times = random_points(6, 3, seed=seed), random_times(6, seed=seed)
    least = integral_of_square(ik.via_point_trajectory(points, times, kind=best), derivative)
    for other in set(others) - {best}:
        assert bool((integral_of_square(ik.via_point_trajectory(points, times, kind=other), derivative) > least).all())
