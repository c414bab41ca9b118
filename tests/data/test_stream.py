"""Streams of tasks: the same batch whatever came before, inside the limits, labels that reach the target."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.solvers.damped import typical_length


def test_a_batch_depends_on_seed_and_number_alone(panda: ik.Robot):
    stream = TaskStream(panda, batch_size=50, seed=3)
    alone = stream.batch(4)
    torch.manual_seed(99)
    in_turn = [rows for _, rows in zip(range(5), stream, strict=False)][4]
    assert all(torch.equal(a, b) for a, b in zip(alone, in_turn, strict=True))
    assert not torch.equal(alone.q, stream.batch(5).q)
    assert not torch.equal(alone.q, TaskStream(panda, batch_size=50, seed=4).batch(4).q)


@pytest.mark.parametrize("spread", [0.5, 0.1, None])
def test_rows_are_inside_the_limits_and_within_the_spread(robot: ik.Robot, spread: float | None):
    T, q, q_current = TaskStream(robot, batch_size=500, spread=spread).batch(0)
    low, high = robot.sampling_range
    assert bool(((q_current >= low) & (q_current <= high)).all())
    assert bool(((q >= robot.q_min) & (q <= robot.q_max)).all())
    torch.testing.assert_close(ik.forward_kinematics(robot, q), T, rtol=0, atol=1e-12)
    move = (q - q_current).abs() / torch.ones(robot.dof).double().masked_fill(~robot.revolute, typical_length(robot))
    if spread is None:
        assert float(move.max()) > 1.0 or not robot.revolute.any()
    else:
        assert bool((move <= spread * (1 + 1e-12)).all())
        assert float(move.max()) > 0.8 * spread


def test_the_solvers_label_reaches_the_target_with_less_movement(panda: ik.Robot):
    made = TaskStream(panda, batch_size=2000).batch(0)
    solved = TaskStream(panda, batch_size=2000, label="solver").batch(0)
    assert torch.equal(made.T, solved.T)
    error = ik.pose_error(ik.forward_kinematics(panda, solved.q), solved.T).norm(dim=-1)
    assert float(error.max()) < 1e-5
    assert bool(((solved.q >= panda.q_min) & (solved.q <= panda.q_max)).all())
    moved = [(rows.q - rows.q_current).norm(dim=-1).mean() for rows in (made, solved)]
    assert moved[1] < 0.95 * moved[0]


def test_joints_of_a_batch_are_spread_evenly(panda: ik.Robot):
    q = TaskStream(panda, batch_size=20000, spread=None).batch(1).q_current
    share = (q - panda.q_min) / (panda.q_max - panda.q_min)
    torch.testing.assert_close(share.mean(0), torch.full((7,), 0.5).double(), rtol=0, atol=0.01)
    torch.testing.assert_close(share.var(0), torch.full((7,), 1 / 12).double(), rtol=0, atol=0.003)
    assert float(torch.corrcoef(share.T).triu(1).abs().max()) < 0.03


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"spread": 0.0}, "spread must be positive and finite, or None for the global task, got 0.0"),
        ({"label": "teacher"}, "label must be 'made' or 'solver', got 'teacher'"),
        ({"seed": -1}, r"seed must be in \[0, 2\^31\), got -1"),
    ],
)
def test_settings_out_of_range_are_refused(panda: ik.Robot, options: dict, text: str):
    with pytest.raises(ik.ConfigError, match=text):
        TaskStream(panda, **options)


def test_a_negative_batch_is_refused(panda: ik.Robot):
    with pytest.raises(ik.ConfigError, match="number of a batch must be in"):
        TaskStream(panda).batch(-1)
