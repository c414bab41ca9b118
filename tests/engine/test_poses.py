"""The small jobs around a solve agree with torch."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.engine.poses import examine, measure, turn_near
from ikgrad.rotations import rotation_angle
from ikgrad.solvers.question import is_rigid


@pytest.fixture
def poses(robot: ik.Robot) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    q = ik.sample_configurations(robot, 200, seed=0)
    T = ik.forward_kinematics(robot, q)
    return q, T, T.roll(1, 0)


def test_examine_accepts_what_is_rigid_and_removes_rounding(poses):
    _, T, _ = poses
    noisy = T + 1e-6 * torch.randn(T.shape, dtype=T.dtype, generator=torch.Generator().manual_seed(0))
    noisy[3, 0, 0], noisy[4, 2, 3], noisy[5, 3, 0] = math.nan, math.inf, 0.1
    noisy[6, :3, :3] *= 1.001
    noisy[7, :3, 1] *= -1
    good, valid = examine(noisy.numpy(), 1e-4)
    np.testing.assert_array_equal(valid, is_rigid(noisy).numpy())
    assert not valid[3:8].any()
    np.testing.assert_array_equal(good[3:8], np.broadcast_to(np.eye(4), (5, 4, 4)))
    R = torch.from_numpy(good[:, :3, :3])
    assert float((R @ R.mT - torch.eye(3)).abs().max()) < 1e-14
    kept = torch.from_numpy(valid)
    assert float((torch.from_numpy(good) - noisy)[kept].abs().max()) < 1e-4


@pytest.mark.parametrize("mask", [None, (1, 1, 1, 0, 0, 0), (1, 1, 1, 1, 1, 0), (0, 1, 0, 0, 0, 1)])
def test_measure_agrees_with_the_pose_error(robot: ik.Robot, poses, mask):
    q, T, G = poses
    weights = None if mask is None else np.array(mask, dtype=float)
    low, high = robot.q_min.numpy(), robot.q_max.numpy()
    valid = np.ones(len(q), dtype=bool)
    options = dict(q_min=low, q_max=high, mask=weights, tol_pos=1e-6, tol_rot=1e-6)
    verdict = measure(T.numpy(), G.numpy(), valid, q.numpy(), **options)
    e = ik.pose_error(T, G)
    if mask is not None:
        Rt = G[:, :3, :3].mT
        e = torch.cat([(Rt @ e[:, :3, None])[..., 0], (Rt @ e[:, 3:, None])[..., 0]], -1) * torch.tensor(mask)
    np.testing.assert_allclose(verdict.position_error, e[:, :3].norm(dim=-1), rtol=1e-12, atol=1e-13)
    angle = rotation_angle(G[:, :3, :3] @ T[:, :3, :3].mT) if mask is None else e[:, 3:].norm(dim=-1)
    np.testing.assert_allclose(verdict.rotation_error, angle, rtol=1e-9, atol=1e-9)
    same = measure(T.numpy(), T.numpy(), valid, q.numpy(), **options)
    assert same.success.all()
    assert not measure(T.numpy(), T.numpy(), ~valid, q.numpy(), **options).success.any()
    outside = np.where(np.isfinite(high), high + 1e-9, 0.0) + 0 * q.numpy()
    if np.isfinite(high).any():
        assert not measure(T.numpy(), T.numpy(), valid, outside, **options).success.any()


def test_turn_near_changes_no_pose_and_keeps_the_range(robot: ik.Robot, poses):
    q, T, _ = poses
    wanted = q + 7 * torch.randn(q.shape, dtype=q.dtype, generator=torch.Generator().manual_seed(1))
    turned = q.numpy().copy()
    turn_near(turned, wanted.numpy(), robot.q_min.numpy(), robot.q_max.numpy(), robot.periodic.numpy())
    moved = torch.from_numpy(turned)
    assert bool(((moved >= robot.q_min) & (moved <= robot.q_max)).all())
    torch.testing.assert_close(ik.forward_kinematics(robot, moved), T, rtol=1e-12, atol=1e-12)
    assert bool(((moved - wanted).abs() <= (q - wanted).abs() + 1e-9).all())
