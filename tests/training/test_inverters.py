"""Training of inverters side by side: the same as one by one, in joint units, and handed back whole."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.data import JointBox, generate
from ikgrad.training.inverters import InverterTraining, answers, mean_squared_error, patterns

ROBOT = ik.load_robot("denso_vp6242")


def sets(count: int = 2, rows: int = 200) -> list[ik.data.DataSet]:
    return [generate(ROBOT, JointBox(count=rows, half_width=0.3, seed=seed)) for seed in range(count)]


def inverters(count: int = 2, **options: object) -> list[ik.Inverter]:
    return [ik.Inverter(ROBOT, seed=seed, hidden=(5,), **options) for seed in range(count)]


@pytest.mark.parametrize("feedback", [False, True])
def test_side_by_side_equals_one_by_one(feedback: bool):
    together, alone = inverters(feedback=feedback), inverters(feedback=feedback)
    training = InverterTraining(together, sets())
    training.run(4)
    training.finish()
    for k, single in enumerate(alone):
        one = InverterTraining([single], [sets()[k]])
        one.run(4)
        one.finish()
        rows = sets()[k].test
        assert torch.allclose(answers(single, rows), answers(together[k], rows), atol=1e-8)


def test_the_history_is_in_joint_units():
    training = InverterTraining(inverters(), sets())
    training.run(3)
    training.finish()
    for k in range(2):
        ours = mean_squared_error(training.inverters[k], training.data[k].train)
        assert torch.allclose(training.training.history.train_table()[-1, k], ours, rtol=1e-10)
        assert torch.allclose(training.test_errors()[k], mean_squared_error(training.inverters[k], sets()[k].test))


def test_levenberg_marquardt_lowers_the_error_every_epoch():
    training = InverterTraining(inverters(), sets())
    training.run(8)
    errors = training.training.history.train_table()
    assert (errors.diff(dim=0) < 0).all()
    assert (errors[-1] < 0.5 * errors[0]).all()


def test_other_optimizers_learn_in_batches():
    nets = inverters(feedback=True)
    training = InverterTraining(
        nets, sets(), optimizer=lambda p, members: torch.optim.Adam(p, 0.01), batch_size=20, shuffle=[0, 1]
    )
    training.run(20)
    training.finish(best=True)
    errors = training.training.history.train_table()
    assert (errors[-1] < 0.3 * errors[0]).all()


def test_the_best_weights_are_those_of_the_smallest_validation_error():
    training = InverterTraining(inverters(), sets(rows=60))
    training.run(25)
    training.finish(best=True)
    validation = training.training.history.validation_table()
    for k, inverter in enumerate(training.inverters):
        ours = mean_squared_error(inverter, training.data[k].validation)
        assert torch.allclose(ours, validation[:, k].min(), rtol=1e-9)


def test_targets_of_a_bounded_inverter_are_scaled_to_the_limits():
    inverter = ik.Inverter(ROBOT, bounded=True)
    training = InverterTraining([inverter], sets(1))
    _, y = patterns(inverter, training.data[0].train)
    assert torch.allclose(inverter.output_scale.inverse(y), training.data[0].train.q)
    training.run(15)
    errors = training.training.history.train_table()
    assert errors[-1].item() < 0.1 * errors[0].item()


def test_what_cannot_be_stacked_is_refused():
    with pytest.raises(ik.ShapeError, match="every inverter needs a data set, got 2 and 1"):
        InverterTraining(inverters(2), sets(1))
    with pytest.raises(ik.ShapeError, match="need the same numbers of rows, got"):
        InverterTraining(inverters(2), [*sets(1), *sets(1, rows=100)])
    with pytest.raises(ik.ShapeError, match="only networks of the same make can be stacked"):
        InverterTraining([*inverters(1), ik.Inverter(ROBOT, hidden=(6,))], sets())


def test_an_inverter_without_validation_rows_is_judged_on_the_training_rows():
    data = generate(ROBOT, JointBox(count=50), validation=0.0)
    training = InverterTraining(inverters(1), [data])
    training.run(2)
    assert training.training.history.validation == []
