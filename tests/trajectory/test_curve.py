"""Evaluation, gradients, extremes and time scaling."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck
from trajectory_cases import CASES, KINDS, ends_for, inside, random_points, random_times

import ikgrad as ik
from ikgrad.trajectory.extremes import extremes


@pytest.fixture
def batch() -> ik.Trajectory:
    return ik.via_point_trajectory(random_points(4, 5, 3), random_times(5), kind="quintic")


@pytest.fixture
def own_times() -> ik.Trajectory:
    return ik.via_point_trajectory(random_points(4, 5, 3), random_times(4, 5), kind="quintic")


def test_times_may_be_one_or_many_shared_or_not(batch: ik.Trajectory):
    t = inside(batch.times, 7)
    assert batch.position(float(t[0])).shape == (4, 3)
    assert batch.position(t[0]).shape == (4, 3)
    assert batch.position(t).shape == (4, 7, 3)
    assert batch.position(t.expand(4, 7)).shape == (4, 7, 3)
    assert batch.position(t.expand(2, 1, 7)).shape == (2, 4, 7, 3)
    assert batch.position([]).shape == (4, 0, 3)
    assert batch.position([1, 2]).shape == (4, 2, 3)
    for other in (t.expand(4, 7), t.expand(2, 1, 7)):
        torch.testing.assert_close(batch.position(other), batch.position(t).expand(*other.shape[:-2], 4, 7, 3))
    torch.testing.assert_close(batch.position(t)[:, 3], batch.position(float(t[3])), rtol=0, atol=1e-12)


def test_unsorted_times_are_as_good(batch: ik.Trajectory):
    t = inside(batch.times, 40)
    order = torch.randperm(40, generator=torch.Generator().manual_seed(0))
    assert torch.equal(batch.velocity(t)[:, order], batch.velocity(t[order]))


@pytest.mark.parametrize("name", ["batch", "own_times"])
def test_each_derivative_is_the_slope_of_the_one_before(name: str, request: pytest.FixtureRequest):
    trajectory = request.getfixturevalue(name)
    t = inside(trajectory.times, 30)
    for d in range(5):
        at = t.clone().requires_grad_()
        value = trajectory(at, derivative=d)
        for joint in range(3):
            rows = range(4) if t.ndim == 1 else [slice(None)]
            for row in rows:
                (slope,) = torch.autograd.grad(value[row, ..., joint].sum(), at, retain_graph=True)
                wanted = trajectory(t, derivative=d + 1)[row, ..., joint]
                torch.testing.assert_close(slope, wanted, rtol=1e-9, atol=1e-9)


def test_names_stand_for_derivatives(batch: ik.Trajectory):
    t = inside(batch.times, 5)
    for d, name in enumerate(("position", "velocity", "acceleration", "jerk")):
        assert torch.equal(getattr(batch, name)(t), batch(t, derivative=d))
    assert torch.equal(batch(t, derivative=6), torch.zeros(4, 5, 3, dtype=torch.float64))


def test_rounding_at_the_ends_is_forgiven_and_no_more():
    trajectory = ik.via_point_trajectory(random_points(3, 2), [0.1, 0.2, 0.7])
    last = trajectory.position(0.7)
    torch.testing.assert_close(trajectory.position(math.nextafter(0.7, 1.0)), last, rtol=0, atol=1e-12)
    single = torch.tensor(0.7, dtype=torch.float32)
    assert float(single) < 0.7 < float(torch.nextafter(single, torch.tensor(1.0)))
    torch.testing.assert_close(trajectory.position(torch.nextafter(single, torch.tensor(1.0))), last, rtol=0, atol=1e-6)
    with pytest.raises(ik.ConfigError, match=r"t = 0.7 lies outside the trajectory, 0.1 to 0.7 s"):
        trajectory.position(0.7 + 1e-9)


@pytest.mark.parametrize(("kind", "m"), CASES)
def test_gradients_reach_points_times_and_ends(kind: str, m: int):
    ends = {name: torch.full((2,), value, dtype=torch.float64) for name, value in ends_for(kind).items()}
    t = inside(random_times(m), 6)

    def values(points: Tensor, times: Tensor, *given: Tensor) -> Tensor:
        named: dict[str, Any] = dict(zip(ends, given, strict=True))
        trajectory = ik.via_point_trajectory(points, times, kind=kind, **named)
        return torch.cat([trajectory.position(t), 0.1 * trajectory.acceleration(t)])

    inputs = [x.requires_grad_() for x in (random_points(m, 2), random_times(m), *ends.values())]
    # Times inside only: a break moves past no sample, and the ends stay where the samples lie.
    assert gradcheck(values, inputs)


@pytest.mark.parametrize("own", [False, True])
def test_second_derivatives_exist(own: bool):
    points = random_points(2, 4, 1).requires_grad_()
    times = random_times(2, 4) if own else random_times(4)
    t = inside(times, 3).requires_grad_()
    assert gradgradcheck(lambda p, t: ik.via_point_trajectory(p, times).position(t), (points, t))


def test_the_gradient_to_the_points_is_the_same_whatever_the_batch():
    points, times = random_points(3, 5, 2).requires_grad_(), random_times(5)
    t = inside(times, 9)
    (together,) = torch.autograd.grad(ik.via_point_trajectory(points, times).velocity(t).square().sum(), points)
    for k in range(3):
        row = points[k].detach().requires_grad_()
        (alone,) = torch.autograd.grad(ik.via_point_trajectory(row, times).velocity(t).square().sum(), row)
        torch.testing.assert_close(together[k], alone, rtol=1e-11, atol=1e-11)


def test_vias_can_be_optimised():
    """A curve from 0 to 1 whose vias are free: the smallest integral of squared jerk is a single quintic's, 720."""
    times = torch.linspace(0, 1, 5, dtype=torch.float64)
    vias = torch.zeros(3, 1, dtype=torch.float64, requires_grad=True)
    t = (torch.arange(200).double() + 0.5) / 200
    optimizer = torch.optim.LBFGS([vias], max_iter=200, line_search_fn="strong_wolfe", tolerance_grad=1e-10)

    def loss() -> Tensor:
        optimizer.zero_grad()
        points = torch.cat([torch.zeros(1, 1), vias, torch.ones(1, 1)]).double()
        value = ik.via_point_trajectory(points, times, kind="quintic").jerk(t).square().mean() / 720
        value.backward()
        return value

    optimizer.step(loss)
    u = times[1:-1, None]
    torch.testing.assert_close(vias.detach(), 10 * u**3 - 15 * u**4 + 6 * u**5, rtol=0, atol=1e-3)


@pytest.mark.parametrize("degree", range(6))
def test_extremes_of_random_polynomials_are_those_of_numpys_roots(degree: int):
    coefficients = random_points(300, degree + 1, seed=degree)
    low, high = extremes(coefficients)
    for row, a, b in zip(coefficients.numpy(), low, high, strict=True):
        polynomial = np.polynomial.Polynomial(row)
        roots = polynomial.deriv().roots() if degree > 1 else np.array([])
        real = roots[np.abs(roots.imag) < 1e-9].real
        values = polynomial(np.concatenate([[0.0, 1.0], real[(real > 0) & (real < 1)]]))
        assert (float(a), float(b)) == pytest.approx((values.min(), values.max()), abs=1e-12)


def test_extremes_are_exact_where_roots_of_the_slope_nearly_meet():
    generator = np.random.default_rng(0)
    rows, wanted = [], []
    for _ in range(500):
        gap, first = 10 ** generator.uniform(-9, -1), generator.uniform(0, 1)
        third = generator.choice([first - gap, generator.uniform(-1, 2)])
        roots = [first, first + gap, third, generator.uniform(-1, 2)][: generator.integers(2, 5)]
        polynomial = np.polynomial.Polynomial.fromroots(roots).integ()
        rows.append(np.pad(polynomial.coef, (0, 6 - len(polynomial.coef))))
        values = polynomial(np.array([0.0, 1.0, *[r for r in roots if 0 < r < 1]]))
        wanted.append((values.min(), values.max()))
    found = torch.stack(extremes(torch.from_numpy(np.array(rows))), dim=-1)
    torch.testing.assert_close(found, torch.tensor(wanted, dtype=torch.float64), rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("derivative", range(4))
def test_no_sample_lies_beyond_the_extremes_and_one_comes_close(kind: str, derivative: int):
    trajectory = ik.via_point_trajectory(random_points(20, 6, 2), random_times(20, 6), kind=kind)
    low, high = trajectory.extremes(derivative=derivative)
    u = torch.linspace(0, 1 - 1e-9, 401, dtype=torch.float64)  # of every segment, up to just before its end
    t = trajectory.times[:, :-1, None] + u * trajectory.times.diff()[..., None]
    samples = trajectory(t.flatten(1), derivative=derivative)
    size = trajectory.peak(derivative=derivative)
    assert bool((samples >= low[:, None] - 1e-12 * size[:, None]).all())
    assert bool((samples <= high[:, None] + 1e-12 * size[:, None]).all())
    assert bool((samples.amin(dim=-2) <= low + 1e-4 * size).all())
    assert bool((samples.amax(dim=-2) >= high - 1e-4 * size).all())
    torch.testing.assert_close(size, torch.maximum(low.abs(), high.abs()))


def test_extremes_of_derivatives_beyond_the_degree_are_zero():
    trajectory = ik.via_point_trajectory(random_points(2, 4, 3), random_times(4), kind="cubic")
    for derivative in (4, 5):
        assert all(torch.equal(x, torch.zeros(2, 3).double()) for x in trajectory.extremes(derivative=derivative))


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_of_peaks_are_exact(kind: str):
    times = random_times(5)
    points = random_points(2, 5, 2).requires_grad_()
    for derivative in range(3):
        assert gradcheck(
            lambda p, d=derivative: ik.via_point_trajectory(p, times, kind=kind).peak(derivative=d), (points,)
        )


def test_scaling_keeps_the_path_and_divides_the_derivatives(batch: ik.Trajectory):
    factor = torch.tensor([0.5, 1.0, 2.0, 3.0], dtype=torch.float64)
    slow = batch.scaled(factor)
    torch.testing.assert_close(slow.duration, factor * batch.duration)
    assert torch.equal(slow.times[:, 0], batch.times[0].expand(4))
    u = torch.linspace(0, 1, 30, dtype=torch.float64)
    t = batch.times[0] + u * batch.duration
    t_slow = slow.times[:, :1] + u * slow.duration[:, None]
    for d in range(4):
        wanted = batch(t, derivative=d) / factor[:, None, None] ** d
        torch.testing.assert_close(slow(t_slow, derivative=d), wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_scaled_to_keeps_every_limit_and_touches_one(kind: str):
    trajectory = ik.via_point_trajectory(random_points(50, 6, 3), random_times(50, 6), kind=kind)
    limits = {
        "velocity_max": torch.tensor([1.0, 0.5, math.inf], dtype=torch.float64),
        "acceleration_max": 2.0,
        "jerk_max": 4 + random_points(50, 3).abs(),
    }
    slow = trajectory.scaled_to(**limits)
    used = torch.stack([slow.peak(derivative=d + 1) / limit for d, limit in enumerate(limits.values())])
    assert float(used.max()) <= 1 + 1e-12
    longer = slow.duration > trajectory.duration
    assert bool(longer.any())
    torch.testing.assert_close(used.amax(dim=(0, 2))[longer], torch.ones(int(longer.sum())).double())
    assert torch.equal(slow.coefficients[~longer], trajectory.coefficients[~longer])


def test_a_trajectory_within_its_limits_is_left_alone_and_can_be_made_faster(batch: ik.Trajectory):
    slow = batch.scaled(100.0)
    same = slow.scaled_to(velocity_max=1.0)
    assert torch.equal(same.coefficients, slow.coefficients)
    fast = slow.scaled(slow.stretch_to(velocity_max=1.0))
    torch.testing.assert_close(fast.peak().amax(dim=-1), torch.ones(4, dtype=torch.float64))


def test_standing_still_needs_no_scaling_and_has_finite_gradients():
    points = torch.zeros(4, 2, dtype=torch.float64, requires_grad=True)
    trajectory = ik.via_point_trajectory(points, [0.0, 1.0, 2.0, 3.0])
    factor = trajectory.stretch_to(velocity_max=1.0, acceleration_max=1.0)
    assert factor.item() == 0.0
    (gradient,) = torch.autograd.grad(factor, points)
    assert bool(gradient.isfinite().all())
    assert torch.equal(trajectory.scaled_to(acceleration_max=1.0).times, trajectory.times)


def test_the_scaling_is_differentiable():
    times = random_times(4)
    points = random_points(3, 4, 2).requires_grad_()
    limits: dict[str, Any] = {"velocity_max": 0.5, "acceleration_max": 0.4}
    assert gradcheck(lambda p: ik.via_point_trajectory(p, times).scaled_to(**limits).duration, (points,))


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        ("4-3-4", (68, 35, 31, 93)),
        ("quintic", (72, 34, 30, 89)),
        ("cubic", (63, 27, 37, 25)),
        ("3-5-3", (101, 67, 76, 292)),
    ],
)
def test_the_table_of_kinds_in_the_documentation(kind: str, wanted: tuple[float, ...]):
    points = torch.tensor([[0, 0, 0, 0], [10, 20, 30, 40], [30, 40, 50, 60], [30, 15, 25, 35]]).double()
    trajectory = ik.via_point_trajectory(points, [0, 2, 5, 8], kind=kind)
    peaks = [trajectory.peak(derivative=d).max().item() for d in range(4)]
    assert peaks == pytest.approx(wanted, abs=0.51)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("kind", KINDS)
def test_on_a_gpu_it_is_the_same_and_stays_there(kind: str):
    points, times = random_points(20, 6, 2), random_times(20, 6)
    here, there = (ik.via_point_trajectory(points.to(d), times.to(d), kind=kind) for d in ("cpu", "cuda"))
    t = inside(times, 9)
    for derivative in range(4):
        value = there(t.cuda(), derivative=derivative)
        assert value.is_cuda
        torch.testing.assert_close(value.cpu(), here(t, derivative=derivative), rtol=1e-9, atol=1e-9)
    slow = there.scaled_to(velocity_max=0.5)
    torch.testing.assert_close(slow.duration.cpu(), here.scaled_to(velocity_max=0.5).duration)
