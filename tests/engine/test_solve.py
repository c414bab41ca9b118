"""The compiled solver, judged by the plain torch kinematics."""

import math

import numpy as np
import pytest
import torch

from ikgrad import engine
from ikgrad.data import sample_configurations
from ikgrad.kinematics import plain_forward_kinematics as forward_kinematics
from ikgrad.kinematics import pose_error


def _errors(robot, q, T):
    e = pose_error(forward_kinematics(robot, torch.from_numpy(q)), T)
    return e[:, :3].norm(dim=-1).numpy(), e[:, 3:].norm(dim=-1).numpy()


def _inside(robot, q):
    return ((q >= robot.q_min.numpy()) & (q <= robot.q_max.numpy())).all(axis=-1)


def _targets(robot, count, seed=0):
    return forward_kinematics(robot, sample_configurations(robot, count, seed=seed))


def test_reachable_poses_are_solved_inside_the_limits(solvable):
    T = _targets(solvable, 400)
    found = engine.solve(engine.pack(solvable), T.numpy())
    position, rotation = _errors(solvable, found.q, T)
    assert found.converged.all()
    assert _inside(solvable, found.q).all()
    assert (position[found.converged] <= 1e-6 * (1 + 1e-6)).all()
    assert (rotation[found.converged] <= 1e-6 * (1 + 1e-6)).all()
    np.testing.assert_allclose(found.position_error, position, atol=1e-12)
    np.testing.assert_allclose(found.rotation_error, rotation, atol=1e-12)


def test_first_start_is_used(solvable):
    q = sample_configurations(solvable, 50, seed=3)
    found = engine.solve(engine.pack(solvable), forward_kinematics(solvable, q).numpy(), q.numpy())
    assert (found.steps == 0).all()
    np.testing.assert_array_equal(found.q, q.numpy())


def test_first_start_outside_the_limits_is_clamped(panda):
    T = _targets(panda, 20)
    found = engine.solve(engine.pack(panda), T.numpy(), np.full((20, 7), 9.0))
    assert found.converged.all()
    assert _inside(panda, found.q).all()


def test_without_limits_nothing_is_clamped(panda):
    q = torch.full((3, 7), 3.5, dtype=torch.float64) + torch.arange(3)[:, None] * 0.1
    T = forward_kinematics(panda, q)
    start = q.numpy() + 0.01
    found = engine.solve(engine.pack(panda), T.numpy(), start, limits=False)
    assert found.converged.all()
    assert (found.q > 3.0).all()


def test_unreachable_poses_end_with_the_best_configuration(panda):
    T = _targets(panda, 20)
    T[:, :3, 3] *= 5 / T[:, :3, 3].norm(dim=-1, keepdim=True)
    found = engine.solve(engine.pack(panda), T.numpy(), max_starts=10)
    assert not found.converged.any()
    assert (found.starts == 10).all()
    assert _inside(panda, found.q).all()
    position, rotation = _errors(panda, found.q, T)
    np.testing.assert_allclose(found.position_error, position, atol=1e-12)
    np.testing.assert_allclose(found.rotation_error, rotation, atol=1e-8)


def test_masked_directions_are_free_in_the_frame_of_the_target(panda):
    T = _targets(panda, 40)
    weights = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 0.0])  # free along and about the target's z axis
    found = engine.solve(engine.pack(panda), T.numpy(), weights=weights)
    assert found.converged.all()
    e = pose_error(forward_kinematics(panda, torch.from_numpy(found.q)), T).reshape(-1, 2, 3)
    local = (e[:, :, None] @ T[:, None, :3, :3]).reshape(-1, 6).numpy()
    assert np.abs(local[:, [0, 1, 3, 4]]).max() <= 1e-6
    assert np.abs(local[:, [2, 5]]).max() > 0.01


def test_half_turns_are_measured_and_solved(panda):
    q = sample_configurations(panda, 30, seed=5)
    T = forward_kinematics(panda, q)
    flip = torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0], dtype=torch.float64))
    once = engine.solve(engine.pack(panda), (T @ flip).numpy(), q.numpy(), max_starts=1, max_steps=0)
    np.testing.assert_allclose(once.rotation_error, math.pi, atol=1e-7)
    np.testing.assert_array_equal(once.q, q.numpy())
    assert np.isfinite(engine.solve(engine.pack(panda), (T @ flip).numpy(), q.numpy()).q).all()


def test_rows_are_bit_identical_wherever_they_stand(solvable):
    T, chain = _targets(solvable, 203).numpy(), engine.pack(solvable)
    q0 = sample_configurations(solvable, 203, seed=9).numpy()
    order = np.random.default_rng(0).permutation(203)
    for start in (None, q0):

        def part(rows, threads, start=start):
            return engine.solve(chain, T[rows], None if start is None else start[rows], threads=threads)

        whole = part(slice(None), 1)
        for a, b in zip(whole, part(order, 2), strict=True):
            np.testing.assert_array_equal(a[order], b)
        for a, b in zip(whole, part(slice(57, 64), 1), strict=True):
            np.testing.assert_array_equal(a[57:64], b)
        for row in (0, 101, 202):
            np.testing.assert_array_equal(part([row], 1).q[0], whole.q[row])


def test_a_seed_repeats_and_another_differs(panda):
    T, chain = _targets(panda, 200).numpy(), engine.pack(panda)
    np.testing.assert_array_equal(engine.solve(chain, T, seed=1).q, engine.solve(chain, T, seed=1).q)
    hard = [engine.solve(chain, T, np.zeros((200, 7)), seed=s) for s in (1, 2)]
    restarted = hard[0].starts > 1
    assert (hard[0].q[restarted] != hard[1].q[restarted]).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300, -1e160])
def test_a_bad_target_fails_alone(panda, bad):
    T, chain = _targets(panda, 19).numpy(), engine.pack(panda)
    good = engine.solve(chain, T)
    T[11, 0, 3] = bad
    found = engine.solve(chain, T, max_starts=20)
    others = np.arange(19) != 11
    np.testing.assert_array_equal(good.q[others], found.q[others])
    assert not found.converged[11]
    assert np.isfinite(found.q[11]).all()
    assert _inside(panda, found.q).all()


def test_a_matrix_that_is_no_pose_does_not_hang(panda):
    T = np.random.default_rng(0).normal(size=(50, 4, 4))
    T[:5] = 0.0
    found = engine.solve(engine.pack(panda), T, max_starts=10)
    assert np.isfinite(found.q).all()


def test_a_bad_first_start_is_ignored(panda):
    T = _targets(panda, 9)
    q0 = sample_configurations(panda, 9, seed=2).numpy()
    q0[4, 2] = np.nan
    found = engine.solve(engine.pack(panda), T.numpy(), q0)
    assert found.converged.all()
    assert max(e.max() for e in _errors(panda, found.q, T)) < 1.1e-6


def test_no_rows_give_no_rows(panda):
    found = engine.solve(engine.pack(panda), np.empty((0, 4, 4)))
    assert found.q.shape == (0, 7)
    assert found.converged.shape == (0,)
