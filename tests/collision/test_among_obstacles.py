"""A robot among obstacles: bounds on speeds, the proof for motions, and the residual in `solve_ik`."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.collision import (
    FunctionMotion,
    PolynomialMotion,
    SampledMotion,
    Spheres,
    check_motion,
    clearance_residual,
    link_segments,
)
from ikgrad.collision.reach import link_reach

UNIT_TIME = torch.tensor([0.0, 1.0], dtype=torch.float64)
THICK, TOL = 0.05, 1e-3


def spheres(size: float = 1.0) -> Spheres:
    centers = torch.tensor([[0.45, 0.1, 0.4], [-0.3, 0.4, 0.6], [0.0, -0.5, 0.3]], dtype=torch.float64)
    return Spheres(size * centers, size * torch.full((3,), 0.12, dtype=torch.float64))


def clearance(robot: ik.Robot, obstacles: Spheres, q: Tensor, size: float = 1.0) -> Tensor:
    return obstacles.distance(link_segments(robot, q), THICK * size).amin(dim=(-2, -1))


def cubics(robot: ik.Robot, count: int) -> Tensor:
    """(count, 1, 4, n) random cubic motions of one second."""
    a, b = (ik.sample_configurations(robot, count, seed=seed) for seed in (1, 2))
    u = torch.randn(count, robot.dof, generator=torch.Generator().manual_seed(3)).double()
    return torch.stack([a, u, 3 * (b - a) - u, -2 * (b - a)], dim=1)[:, None]


def test_no_end_of_a_link_is_faster_than_its_bound(robot: ik.Robot):
    q = ik.sample_configurations(robot, 300, seed=0)
    qd = torch.randn(q.shape, generator=torch.Generator().manual_seed(1)).double()
    h = 1e-6
    moved = link_segments(robot, q + h * qd) - link_segments(robot, q - h * qd)
    speed = moved.norm(dim=-1).amax(dim=-1) / (2 * h)  # (300, L)
    assert bool((speed <= link_reach(robot).speed(qd.abs(), q.abs()) + 1e-6 * robot.length).all())


@pytest.mark.parametrize(("name", "size"), [("panda", 1.0), ("arm4", 25.0)])
def test_the_check_misses_nothing_that_dense_sampling_finds(name: str, size: float):
    robot = ik.load_robot(name)
    obstacles, coefficients, tol = spheres(size), cubics(robot, 150), TOL * size
    check = check_motion(robot, PolynomialMotion(UNIT_TIME, coefficients), obstacles, link_radius=THICK * size, tol=tol)
    t = torch.linspace(0, 1, 1000, dtype=torch.float64)
    q = (t[:, None] ** torch.arange(4)) @ coefficients[:, 0]  # (150, 1000, n)
    nearest = clearance(robot, obstacles, q, size).amin(dim=-1)
    assert not bool((check.free & (nearest <= 0)).any())
    assert 20 < int(check.free.sum()) < 130
    assert not bool((check.free & check.touches).any())
    neither = ~check.free & ~check.touches
    assert bool((check.clearance[neither] <= tol).all())
    hit = torch.nonzero(check.touches).flatten()
    there = ((check.time[hit, None] ** torch.arange(4))[:, None] @ coefficients[hit, 0])[:, 0]
    depth = clearance(robot, obstacles, there, size)
    assert bool((depth <= 1e-9).all())
    assert bool((depth[~check.starts_touching[hit]] > -tol).all())  # the first contact, to the resolution
    assert bool((check.time[check.free] == math.inf).all())
    assert bool((check.link[check.free] == -1).all())


def middle_swing(panda: ik.Robot) -> Tensor:
    """(1, 2, 7) joint 1 from the middle of the range at 1 rad/s."""
    return torch.stack([panda.q_min.lerp(panda.q_max, 0.5), torch.eye(7, dtype=torch.float64)[0]])[None]


def test_contact_between_two_free_ends_is_found(panda: ik.Robot):
    ball = Spheres(torch.tensor([[0.3, 0.3, 0.6]]), torch.tensor([0.1]))
    motion = PolynomialMotion(torch.tensor([-1.0, 3.0]), middle_swing(panda) + 0.0)
    ends = motion.position(torch.tensor([0, 0]), torch.tensor([-1.0, 3.0]).double())
    assert bool((clearance(panda, ball, ends) > 0).all())
    check = check_motion(panda, motion, ball, link_radius=THICK)
    assert bool(check.touches)
    assert not bool(check.starts_touching)


def test_functions_and_polynomials_get_consistent_verdicts(panda: ik.Robot):
    c = cubics(panda, 60)
    table = c[:, 0]

    def position(row: Tensor, t: Tensor) -> Tensor:
        return ((t[:, None] ** torch.arange(4))[:, None] @ table[row])[:, 0]

    def speed_bound(row: Tensor, t0: Tensor, t1: Tensor) -> Tensor:
        return (table[row, 1:].abs() * torch.tensor([1.0, 2.0, 3.0]).double()[:, None]).sum(dim=1)

    a = check_motion(panda, PolynomialMotion(UNIT_TIME, c), spheres(), link_radius=THICK)
    b = check_motion(panda, FunctionMotion(position, speed_bound, UNIT_TIME, count=60), spheres(), link_radius=THICK)
    assert not bool((a.free & b.touches).any())
    assert not bool((b.free & a.touches).any())
    assert int((a.free != b.free).sum()) <= 2  # near misses may fall on either side


def test_samples_prove_only_what_the_speed_allows(panda: ik.Robot):
    q = panda.q_min.lerp(panda.q_max, 0.5).expand(2, 3, 7)
    far = Spheres(torch.tensor([[2.0, 0.0, 0.0]]), torch.tensor([0.1]))
    slow, fast = torch.zeros(7).double(), torch.full((7,), 50.0).double()
    times = torch.tensor([0.0, 0.5, 1.0])
    assert bool(check_motion(panda, SampledMotion(times, q, slow), far).free.all())
    check = check_motion(panda, SampledMotion(times, q, fast), far)
    assert not bool(check.free.any())
    assert not bool(check.touches.any())
    assert check.samples.tolist() == [3, 3]


def test_a_start_that_touches_is_named(panda: ik.Robot):
    swing = middle_swing(panda)
    away = swing.clone()
    away[0, 0, 0] += math.pi / 2
    hand = link_segments(panda, swing[0, 0])[-1, 1]
    ball = Spheres(hand[None], torch.tensor([0.05], dtype=torch.float64))
    still = torch.stack([away, swing]) * torch.tensor([1.0, 0.0]).double()[:, None]
    check = check_motion(panda, PolynomialMotion(UNIT_TIME, still), ball)
    assert check.free.tolist() == [True, False]
    assert check.starts_touching.tolist() == [False, True]
    with pytest.raises(ik.CollisionError, match=r"1 of 2 motions are not free: motion 1 already touches where it sta"):
        check.raise_if_touching()


def test_bad_motions_are_refused(panda: ik.Robot):
    swing, ball = middle_swing(panda), spheres()
    for times, text in (([0.0, 0.0], r"times must increase, but times\[1\] is 0"), ([0.0, math.nan], "must be finite")):
        with pytest.raises(ik.ConfigError, match=text):
            PolynomialMotion(torch.tensor(times), swing)
    with pytest.raises(ik.ShapeError, match=r"times must have shape \(\.\.\., 2\), got \(3,\)"):
        PolynomialMotion(torch.tensor([0.0, 1.0, 2.0]), swing)
    with pytest.raises(ik.ConfigError, match=r"motion 0 jumps by 1 in joint 0 at times\[1\]"):
        PolynomialMotion(torch.tensor([0.0, 1.0, 2.0]), swing.repeat(2, 1, 1))
    with pytest.raises(ik.ConfigError, match=r"coefficients\[0, 0, 0\] is nan"):
        PolynomialMotion(UNIT_TIME, swing * math.nan)
    with pytest.raises(ik.ShapeError, match="robot 'panda' has 7 joints, the motion 6"):
        check_motion(panda, PolynomialMotion(UNIT_TIME, swing[..., :6]), ball)
    with pytest.raises(ik.ConfigError, match="tol must be a positive finite number, got 0"):
        check_motion(panda, PolynomialMotion(UNIT_TIME, swing), ball, tol=0.0)
    broken = FunctionMotion(lambda row, t: t[:, None] * math.nan, lambda row, t0, t1: t0[:, None], UNIT_TIME, count=1)
    with pytest.raises(ik.ConfigError, match=r"position of motion 0 at t = 0 is \[nan\]"):
        check_motion(panda, broken, ball)


def clear_poses(robot: ik.Robot, count: int) -> Tensor:
    """Poses of configurations that keep 2 cm."""
    q = ik.sample_configurations(robot, 20 * count, seed=4)
    return ik.forward_kinematics(robot, q[clearance(robot, spheres(), q) >= 0.02][:count])


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_residual_finds_clear_answers_and_keeps_the_pose(name: str):
    robot = ik.load_robot(name)
    T = clear_poses(robot, 150)
    wish = clearance_residual(robot, spheres(), margin=0.02, link_radius=THICK)
    plain, wished = ik.solve_ik(robot, T), ik.solve_ik(robot, T, extra_residual=wish)
    assert bool(wished.success.all())
    e = ik.pose_error(ik.forward_kinematics(robot, wished.q), T)
    assert float(e.abs().max()) <= 1.0001e-6
    clear = [float((clearance(robot, spheres(), x.q) >= 0.02 - 1e-8).double().mean()) for x in (plain, wished)]
    assert clear[1] >= 0.98
    assert clear[0] < clear[1]


def test_a_residual_that_is_never_zero_is_made_small(panda: ik.Robot):
    T, home = clear_poses(panda, 20), panda.q_min.lerp(panda.q_max, 0.5)
    plain, wished = ik.solve_ik(panda, T), ik.solve_ik(panda, T, extra_residual=lambda q: q - home)
    assert bool(wished.success.all())
    assert float((wished.q - home).norm(dim=-1).mean()) < float((plain.q - home).norm(dim=-1).mean())


def test_methods_without_restarts_take_the_residual_too(panda: ik.Robot):
    q = panda.q_min.lerp(panda.q_max, 0.5) + 0.1 * torch.arange(3).double()[:, None]
    T = ik.forward_kinematics(panda, q)
    wish = clearance_residual(panda, spheres(), link_radius=THICK)
    solution = ik.solve_ik(panda, T, q0=q + 0.05, solver=ik.NewtonRaphson(), extra_residual=wish)
    assert bool(solution.success.all())


def test_a_wrong_extra_residual_is_refused(panda: ik.Robot):
    T = clear_poses(panda, 2)
    with pytest.raises(ik.ShapeError, match=r"extra_residual must map \(\.\.\., n\) to floating-point \(\.\.\., m\)"):
        ik.solve_ik(panda, T, extra_residual=lambda q: q.sum())
    with pytest.raises(ik.ConfigError, match="extra_residual chooses one solution a row; leave solutions at 1"):
        ik.solve_ik(panda, T, solutions=2, extra_residual=lambda q: q)
    with pytest.raises(ik.ConfigError, match="margin must be a positive finite number, got -1"):
        clearance_residual(panda, spheres(), margin=-1.0)
