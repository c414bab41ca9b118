"""Straight lines: straight, reached, inside the limits, smooth, and the same for the same seed."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.data.paths import joint_units, straight_lines
from ikgrad.kinematics import plain_forward_kinematics
from ikgrad.rotations import log_rotation


@pytest.mark.parametrize("name", ["panda", "ur5e", "kr210"])
def test_lines_are_straight_and_can_be_followed(name: str):
    robot = ik.load_robot(name)
    lines = straight_lines(robot, 4, 60, seed=1)
    p, R = lines.T[..., :3, 3], lines.T[..., :3, :3]
    assert p.diff(n=2, dim=1).abs().max() < 1e-12  # even steps
    turn = log_rotation(R[:, :-1].mT @ R[:, 1:])
    assert (turn - turn[:, :1]).abs().max() < 1e-7  # the same axis and angle all along
    assert (p[:, -1] - p[:, 0]).norm(dim=-1).min() > 1e-3
    assert (plain_forward_kinematics(robot, lines.q) - lines.T).abs().max() < 1e-8
    assert ((lines.q >= robot.q_min) & (lines.q <= robot.q_max)).all()
    assert (lines.q.diff(dim=1).abs() / joint_units(robot)).max() <= 0.1


def test_the_seed_decides(panda: ik.Robot):
    first, again, other = (straight_lines(panda, 2, 20, seed=seed).T for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.isclose(first, other).all(dim=(1, 2, 3)).any()


def test_slides_count_in_typical_lengths(zoo_path):
    robot = ik.load_robot(zoo_path, tip="hand")
    units = joint_units(robot)
    assert (units[robot.revolute] == 1).all()
    assert (units[~robot.revolute] < 1).all()
