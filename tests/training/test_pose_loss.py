"""The pose loss: the analytic gradient is autograd's through the chain, and limits behave."""

from __future__ import annotations

import math

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.kinematics import plain_forward_kinematics
from ikgrad.solvers.damped import typical_length
from ikgrad.training import PoseLoss

SHAPES = ("square", "root", "log")


@pytest.mark.parametrize("shape", SHAPES)
def test_the_gradient_is_that_of_autograd_through_the_chain(robot: ik.Robot, shape: str):
    T, _, q = TaskStream(robot, batch_size=40, seed=1).batch(0)
    loss = PoseLoss(shape=shape)  # type: ignore[arg-type]
    q = q.requires_grad_()
    ours = loss(robot, q, T)
    scale = torch.tensor([1 / typical_length(robot)] * 3 + [1.0] * 3, dtype=torch.float64)
    s = (ik.pose_error(plain_forward_kinematics(robot, q), T) * scale).square().sum(-1)
    delta = loss.delta
    theirs = {"square": s, "root": (s + delta**2).sqrt(), "log": (s + delta**2).log()}[shape].mean()
    torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-12)
    grads = [torch.autograd.grad(value, q, retain_graph=True)[0] for value in (ours, theirs)]
    torch.testing.assert_close(*grads, rtol=1e-7, atol=1e-8)


def test_the_gradient_passes_gradcheck(panda: ik.Robot):
    T, _, q = TaskStream(panda, batch_size=3, seed=2).batch(0)
    assert torch.autograd.gradcheck(lambda q: PoseLoss(shape="log")(panda, q, T), q.requires_grad_())


def test_joints_beyond_a_limit_are_drawn_back_and_judged_at_it(panda: ik.Robot):
    q = (0.5 * (panda.q_min + panda.q_max))[None].repeat(2, 1)
    q[:, 0] = panda.q_max[0] + 0.3
    at_limit = q.clamp(panda.q_min, panda.q_max)
    T = ik.forward_kinematics(panda, at_limit)
    outside = q.clone().requires_grad_()
    loss = PoseLoss(shape="square", limits=0.5)(panda, outside, T)
    assert loss.item() == pytest.approx(0.5 * 0.5 * 0.3**2, rel=1e-9)
    loss.backward()
    expected = torch.zeros(2, 7).double()
    expected[:, 0] = 0.5 * 0.3 / 2
    torch.testing.assert_close(outside.grad, expected, rtol=0, atol=1e-9)


def test_labels_count_by_their_weight(panda: ik.Robot):
    T, label, q = TaskStream(panda, batch_size=20).batch(0)
    with_label = PoseLoss(joints=0.3)(panda, q, T, label) - PoseLoss()(panda, q, T)
    distance = ((q - label).square().sum(-1) + 1e-4).sqrt().mean()
    assert float(with_label) == pytest.approx(0.3 * float(distance), rel=1e-9)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"shape": "cube"}, "shape must be square, root or log, got 'cube'"),
        ({"delta": 0.0}, "delta must be positive, got 0.0"),
        ({"limits": -1.0}, "limits must be a finite weight, 0 or more, got -1.0"),
        ({"joints": math.nan}, "joints must be a finite weight, 0 or more, got nan"),
    ],
)
def test_settings_out_of_range_are_refused(options: dict, text: str):
    with pytest.raises(ik.ConfigError, match=text):
        PoseLoss(**options)
