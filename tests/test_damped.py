"""Damped steps: the compiled kernel, the torch path and the solver agree; limits hold; rows stand alone."""

from __future__ import annotations

import numpy as np
import pytest
import roma
import torch

import ikgrad as ik
from ikgrad import engine
from ikgrad.engine.damped import damped
from ikgrad.rotations import drawn_log_rotation
from ikgrad.solvers.damped import _plain, damped_steps, solve_spd, typical_length


def task(robot: ik.Robot, count: int = 61, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rows = ik.data.TaskStream(robot, batch_size=count, seed=seed).batch(0)
    return rows.T, rows.q_current


@pytest.mark.parametrize("steps", [0, 1, 4])
def test_the_kernel_is_the_plain_torch_path(robot: ik.Robot, steps: int):
    T, q = task(robot)
    for ours, plain in zip(damped_steps(robot, T, q, steps=steps), _plain(robot, T, q, steps, 0.1, 0.8), strict=True):
        torch.testing.assert_close(ours, plain, rtol=1e-6, atol=1e-7)  # singular rows amplify rounding by 1 / mu


def test_the_slope_is_minus_half_the_gradient_of_the_squared_error(robot: ik.Robot):
    T, q = task(robot)
    slope = damped_steps(robot, T, q).slope
    q = q.clone().requires_grad_()
    e = ik.pose_error(ik.forward_kinematics(robot, q), T).unflatten(-1, (2, 3)).square().sum(-1)
    for half, scale in ((0, typical_length(robot) ** -2), (1, 1.0)):
        (grad,) = torch.autograd.grad(e[:, half].sum() * scale, q, retain_graph=True)
        torch.testing.assert_close(slope[:, half], -0.5 * grad, rtol=1e-7, atol=1e-8)


def test_the_error_is_the_pose_error_seen_from_the_tip(robot: ik.Robot):
    T, q = task(robot)
    pose = ik.forward_kinematics(robot, q)
    e = ik.pose_error(pose, T).unflatten(-1, (2, 3)) @ pose[:, :3, :3]
    e[:, 0] /= typical_length(robot)
    torch.testing.assert_close(damped_steps(robot, T, q).error, e.flatten(1), rtol=1e-8, atol=1e-9)


def test_both_layers_use_the_same_length(robot: ik.Robot):
    assert typical_length(robot) == pytest.approx(engine.pack(robot).length, rel=1e-12)


def test_steps_one_by_one_are_steps_at_once_and_stay_inside_the_limits(robot: ik.Robot):
    T, q = task(robot)
    one = q
    for _ in range(5):
        found = damped_steps(robot, T, one)
        one = found.q + found.step
    five = damped_steps(robot, T, q, steps=5).q
    torch.testing.assert_close(five, one, rtol=0, atol=1e-12)
    assert bool(((five >= robot.q_min) & (five <= robot.q_max)).all())


def test_twelve_steps_solve_nearly_every_local_row(panda: ik.Robot):
    T, q = task(panda, 2000)
    found = damped_steps(panda, T, q, steps=12)
    error = ik.pose_error(ik.forward_kinematics(panda, found.q), T)
    assert (error.norm(dim=-1) < 1e-6).double().mean() > 0.98


def test_rows_do_not_influence_each_other(panda: ik.Robot):
    T, q = task(panda, 37)
    whole, threads = damped(engine.pack(panda), T.numpy(), q.numpy(), steps=2), 2
    T[3] = torch.nan
    for other in (
        damped(engine.pack(panda), T.numpy()[5:], q.numpy()[5:], steps=2),
        damped(engine.pack(panda), np.repeat(T.numpy(), 100, 0)[500:3700:100], q.numpy()[5:], steps=2, threads=threads),
    ):
        for a, b in zip(whole, other, strict=True):
            np.testing.assert_array_equal(a[5:], b)


def test_any_batch_shape_and_dtype_and_nothing_is_changed(panda: ik.Robot):
    T, q = task(panda, 6)
    before = q.clone()
    found = damped_steps(panda, T.view(3, 1, 2, 4, 4), q.view(3, 1, 2, 7).float())
    assert [tuple(part.shape) for part in found] == [(3, 1, 2, 7), (3, 1, 2, 6), (3, 1, 2, 7), (3, 1, 2, 2, 7)]
    assert {part.dtype for part in found} == {torch.float32}
    assert damped_steps(panda, T[0], q).q.shape == (6, 7)
    assert torch.equal(q, before)


def test_solve_spd_solves():
    generator = torch.Generator().manual_seed(0)
    J = torch.randn(50, 6, 7, generator=generator, dtype=torch.float64)
    A, b = J @ J.mT + 1e-6 * torch.eye(6), torch.randn(50, 6, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(A @ solve_spd(A, b)[..., None], b[..., None], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-7, 1e-12, 0.0])
def test_the_drawn_logarithm_is_exact_near_nothing_near_half_a_turn_and_between(scale: float):
    generator = torch.Generator().manual_seed(0)
    axis = torch.nn.functional.normalize(torch.randn(2000, 3, generator=generator, dtype=torch.float64), dim=1)
    size = scale * torch.pi * torch.rand(2000, 1, generator=generator, dtype=torch.float64)
    for angle in (size, torch.pi - size):
        R = roma.rotvec_to_rotmat(angle * axis)
        found = drawn_log_rotation(R)
        torch.testing.assert_close(roma.rotvec_to_rotmat(found), R, rtol=0, atol=1e-14)
        torch.testing.assert_close(found.norm(dim=1, keepdim=True), angle, rtol=4e-15, atol=4e-15 if scale else 0.0)
    assert drawn_log_rotation(torch.eye(3)).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"steps": -1}, "steps must not be negative, got -1"),
        ({"damping": 0.0}, "damping must be positive, got 0.0"),
        ({"max_step": -0.1}, "max_step must be positive, got -0.1"),
    ],
)
def test_settings_out_of_range_are_refused(panda: ik.Robot, options: dict, text: str):
    with pytest.raises(ik.ConfigError, match=text):
        damped_steps(panda, torch.eye(4).double(), torch.zeros(7).double(), **options)
