"""Training within a budget: it learns, it goes on as if it had never stopped, and it says what is wrong."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.networks import IncrementInverter, UnrolledInverter
from ikgrad.training import EndlessTraining, PoseLoss, load_checkpoint, save_checkpoint


@pytest.fixture
def ur5e() -> ik.Robot:
    return ik.load_robot("ur5e")


def make(robot: ik.Robot, *, steps: int = 30, **options) -> EndlessTraining:
    inverter = IncrementInverter(robot, width=32, depth=3, seed=1)
    return EndlessTraining(inverter, TaskStream(robot, batch_size=128, seed=2), steps=steps, **options)


def same_weights(a: EndlessTraining, b: EndlessTraining) -> bool:
    left, right = a.inverter.state_dict(), b.inverter.state_dict()
    return all(torch.equal(left[name], right[name]) for name in left)


@pytest.mark.parametrize(("family", "fall"), [(IncrementInverter, 0.9), (UnrolledInverter, 0.6)])
def test_a_training_of_a_second_reduces_the_error(family: type[IncrementInverter], fall: float, ur5e: ik.Robot):
    training = EndlessTraining(family(ur5e, width=32), TaskStream(ur5e, batch_size=256), steps=150, checks=5)
    training.run()
    first, last = training.history[0], training.history[-1]
    assert last.position_mm[0] < fall * first.position_mm[0]
    assert last.rotation_deg[0] < fall * first.rotation_deg[0]
    assert training.progress == 1.0


def test_the_same_seeds_give_the_same_weights(ur5e: ik.Robot):
    one, two = make(ur5e), make(ur5e)
    one.run()
    torch.manual_seed(7)
    two.run()
    assert same_weights(one, two)


def test_a_stopped_training_goes_on_as_if_it_had_not(ur5e: ik.Robot, tmp_path: Path):
    straight, stopped, resumed = make(ur5e), make(ur5e), make(ur5e)
    straight.run()
    stopped.run(until=0.5)
    assert stopped.step == 15
    save_checkpoint(tmp_path / "half.ckpt", stopped.state_dict())
    resumed.load_state_dict(load_checkpoint(tmp_path / "half.ckpt"))
    resumed.run()
    assert same_weights(straight, resumed)
    assert [check.step for check in resumed.history] == [check.step for check in straight.history]
    assert resumed.best_loss == straight.best_loss


def test_the_best_weights_are_kept(ur5e: ik.Robot):
    training = make(ur5e, lr=0.01, checks=10)
    seen: list[tuple[float, dict]] = []
    training.run(watch=lambda t: seen.append((t.history[-1].loss, copy.deepcopy(t.inverter.state_dict()))))
    loss, weights = min(seen, key=lambda pair: pair[0])
    assert training.best_loss == loss
    assert all(torch.equal(weights[name], value) for name, value in training.inverter.state_dict().items())


def test_a_budget_of_time_is_kept(ur5e: ik.Robot):
    training = EndlessTraining(
        IncrementInverter(ur5e, width=16), TaskStream(ur5e, batch_size=64), minutes=0.3 / 60, checks=3
    )
    training.run()
    assert training.progress == 1.0
    assert training.step > 1
    assert training.history[-1].seconds >= 0.3


def test_a_loss_that_is_not_finite_ends_it_with_the_best_weights(ur5e: ik.Robot):
    training = make(ur5e, steps=40, checks=40)
    training.run(until=0.5)
    best = copy.deepcopy(training._best)
    training.inverter.network.layers[0].weight.data[:] = torch.nan
    with pytest.raises(ik.TrainingError, match="the loss is not finite in step 21; the best weights are back"):
        training.run()
    assert all(torch.equal(best[name], value) for name, value in training.inverter.state_dict().items())


def test_validation_rows_are_not_those_of_the_training(ur5e: ik.Robot):
    training = make(ur5e)
    assert not torch.equal(training.validation.q_current[:128], training.stream.batch(0).q_current)
    own = TaskStream(ur5e, batch_size=9, seed=5)
    assert torch.equal(make(ur5e, validation=own).validation.T, own.batch(0).T)


def test_settings_out_of_range_are_refused(ur5e: ik.Robot):
    inverter, stream = IncrementInverter(ur5e, width=8), TaskStream(ur5e)
    for options, text in [
        ({}, "give a budget: minutes or steps, one of them"),
        ({"minutes": 1.0, "steps": 3}, "give a budget: minutes or steps, one of them"),
        ({"minutes": -1.0}, "minutes must be positive and finite, got -1.0"),
        ({"steps": 0}, "steps must be positive and finite, got 0"),
        ({"steps": 3, "lr": 0.0}, "lr must be positive and finite, got 0.0"),
        ({"steps": 3, "checks": 0}, "checks must be positive and finite, got 0"),
    ]:
        with pytest.raises(ik.ConfigError, match=text):
            EndlessTraining(inverter, stream, **options)
    with pytest.raises(ik.RobotError, match=r"the inverter is for robot 'ur5e' \(.*\), the stream for 'panda'"):
        EndlessTraining(inverter, TaskStream(ik.load_robot("panda")), steps=3)


@pytest.mark.parametrize("family", [IncrementInverter, UnrolledInverter])
def test_nothing_of_a_step_stays_on_the_cpu(family: type[IncrementInverter], ur5e: ik.Robot):
    """The meta device refuses to meet tensors of the CPU, as a GPU does."""
    rows = [part.to("meta") for part in TaskStream(ur5e, batch_size=8).batch(0)]
    inverter = family(ur5e, width=16).to("meta")
    answers = inverter.iterates(rows[0], rows[2])
    loss = sum(PoseLoss(joints=0.1)(ur5e, q, rows[0], rows[1]) for q in answers)
    gradients = torch.autograd.grad(loss, list(inverter.parameters()))
    assert {tensor.device.type for tensor in (loss, *answers, *gradients)} == {"meta"}


def test_a_training_without_the_compiled_kernels_is_the_same(ur5e: ik.Robot, monkeypatch):
    """What runs on a GPU, on the CPU."""
    from ikgrad.solvers import damped

    compiled = make(ur5e, checks=5)
    compiled.run()
    monkeypatch.setattr(damped, "_compiled", damped._plain)
    plain = make(ur5e, checks=5)
    plain.run()
    found = [torch.tensor([check.loss for check in training.history]) for training in (plain, compiled)]
    torch.testing.assert_close(*found, rtol=1e-4, atol=0)  # Muon's bfloat16 makes more of a rounding error


def test_the_loss_can_be_chosen(ur5e: ik.Robot):
    assert make(ur5e).loss == PoseLoss(shape="root", delta=0.02)
    assert make(ur5e, loss=PoseLoss(shape="square")).loss.shape == "square"
