"""Evaluation: known errors come out as they are, rows that are lost count, and baselines stand beside."""

from __future__ import annotations

import json

import pytest
import torch
from torch import Tensor, nn

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.evaluation import evaluate, measure
from ikgrad.networks import UnrolledInverter


def test_a_known_error_is_measured(robot: ik.Robot):
    q = ik.sample_configurations(robot, 200, seed=0)
    T = ik.forward_kinematics(robot, q)
    T[:, 0, 3] += 0.003
    angle = torch.tensor(0.02)
    turn = torch.eye(3).double()
    turn[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    T[:, :3, :3] = turn @ T[:, :3, :3]
    errors = measure(robot, q, T)
    assert errors.position_mm == pytest.approx((3.0, 3.0, 3.0), rel=1e-9)
    assert errors.rotation_deg == pytest.approx((1.1459156, 1.1459156, 1.1459156), rel=1e-6)
    assert (errors.mean_position_mm, errors.inside, errors.close) == (pytest.approx(3.0), 1.0, 0.0)


def test_shares_and_percentiles_count_rows(panda: ik.Robot):
    q = ik.sample_configurations(panda, 1000, seed=0)
    T = ik.forward_kinematics(panda, q)
    T[:100, 2, 3] += 0.0005  # close, not exact
    T[100:160, 2, 3] += 0.02  # 6 % off: the 95th percentile sees them
    q[990:] = torch.nan
    errors = measure(panda, q, T)
    assert errors.close == pytest.approx(0.93)
    assert errors.exact == pytest.approx(0.83)
    assert errors.position_mm[0] < 1e-9
    assert errors.position_mm[1] == pytest.approx(20.0)
    assert errors.position_mm[2] == float("inf")
    q[0, 0] = panda.q_max[0] + 1e-9
    assert measure(panda, q, T).inside == pytest.approx(0.989)


class Oracle(nn.Module):
    """Knows the answers of one batch."""

    feedback = False

    def __init__(self, task: TaskStream):
        super().__init__()
        self.robot, self.q = task.robot, task.batch(0).q

    def forward(self, T: Tensor) -> Tensor:
        return self.q[: len(T)]


def test_the_table_has_the_inverter_its_steps_and_the_baselines(panda: ik.Robot):
    task = TaskStream(panda, batch_size=300)
    found = evaluate(Oracle(task), task, solver_steps=1, plain_steps=(0, 2))
    names = [row.method for row in found.rows]
    assert names[:4] == ["inverter", "inverter + 1 step", "plain, 0 steps", "plain, 2 steps"]
    assert names[4].startswith("plain, in the same time: ")
    assert [row.errors.exact for row in found.rows[:3]] == [1.0, 1.0, 0.0]
    assert all(row.microseconds > 0 for row in found.rows)
    assert (found.robot, found.count, found.task) == ("panda", 300, "local, 0.5 rad")
    assert json.loads(json.dumps(found.record()))["rows"][0]["errors"]["exact"] == 1.0
    title, _, head, _, first, *_ = found.lines()
    assert "panda, task local, 0.5 rad, 300 poses, seed 0" in title
    assert head.count("|") == first.count("|") == 8
    assert "100.00 %" in first


def test_an_inverter_with_present_joints_gets_them(panda: ik.Robot):
    found = evaluate(UnrolledInverter(panda, width=8), TaskStream(panda, batch_size=100, spread=None), plain_steps=())
    assert found.task == "global"
    assert [row.errors.inside for row in found.rows] == [1.0] * 5


def test_what_does_not_fit_is_refused(panda: ik.Robot):
    inverter = UnrolledInverter(panda, width=8)
    with pytest.raises(ik.RobotError, match=r"the inverter is for robot 'panda' \(.*\), the task for 'ur5e'"):
        evaluate(inverter, TaskStream(ik.load_robot("ur5e")))
    with pytest.raises(ik.ConfigError, match=r"numbers of steps must not be negative, got -1 and \(1,\)"):
        evaluate(inverter, TaskStream(panda), solver_steps=-1, plain_steps=(1,))
    q, T = torch.zeros(3, 7), torch.eye(4).repeat(3, 1, 1)
    with pytest.raises(ik.ShapeError, match=r"q and T_target must have the same rows, got \(3, 7\) and \(2, 4, 4\)"):
        measure(panda, q, T[:2])
    with pytest.raises(ik.DataError, match="there are no rows to measure"):
        measure(panda, q[:0], T[:0])
