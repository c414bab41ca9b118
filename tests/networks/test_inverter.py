"""`Inverter`: shapes, scaling inside the model, joint limits, closed loop, refusals."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.networks import ENCODINGS

ROBOT = ik.load_robot("denso_vp6242")


def data(count: int = 60, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    q = 0.3 * (ik.sample_configurations(ROBOT, count, seed=seed) + 0.1)
    return ik.forward_kinematics(ROBOT, q), q, q + 0.01


def fitted(**options: object) -> ik.Inverter:
    inverter = ik.Inverter(ROBOT, **options)
    T, q, now = data()
    return inverter.fit(T, q, now if inverter.feedback else None)


@pytest.mark.parametrize("feedback", [False, True])
@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_any_batch_shape_equals_row_by_row(feedback: bool, encoding: str, shape: tuple[int, ...]):
    inverter = fitted(feedback=feedback, encoding=encoding, hidden=(7, 5))
    count = int(torch.tensor(shape).prod()) if shape else 1
    T, _, now = data(count, seed=1)
    arguments = (T.reshape(*shape, 4, 4), now.reshape(*shape, 6))[: 1 + feedback]
    q = inverter(*arguments)
    assert q.shape == (*shape, 6)
    looped = torch.stack([inverter(*((T[k], now[k])[: 1 + feedback])) for k in range(count)])
    assert torch.allclose(q.reshape(-1, 6), looped, atol=1e-13)


def test_present_joints_broadcast_against_poses():
    inverter = fitted(feedback=True)
    T, _, now = data(5)
    assert torch.allclose(inverter(T, now[0]), inverter(T, now[0].expand(5, 6)))
    assert inverter(T[0], now).shape == (5, 6)


def test_training_data_are_scaled_to_plus_minus_one():
    inverter = fitted(feedback=True)
    T, q, now = data()
    for scaled in (inverter.input_scale(inverter.features(T, now)), inverter.output_scale(q)):
        assert torch.allclose(scaled.amin(0), torch.tensor(-1.0).double())
        assert torch.allclose(scaled.amax(0), torch.tensor(1.0).double())


def test_columns_of_rounding_noise_count_as_constant():
    T, q, _ = data()
    T[:, :3, :3] = T[0, :3, :3]
    T[:, 0, 0] += 1e-13 * torch.randn(60, generator=torch.Generator().manual_seed(0)).double()
    inverter = ik.Inverter(ROBOT).fit(T, q)
    assert (inverter.input_scale.span[3:] == 0).all()
    assert (inverter.input_scale.span[:3] > 0).all()


def test_the_default_reference_is_amid_the_data_and_a_given_one_stays():
    T, q, _ = data()
    inverter = ik.Inverter(ROBOT).fit(T, q)
    assert torch.allclose(inverter.reference[:3, 3], T[:, :3, 3].mean(0))
    R = inverter.reference[:3, :3]
    assert torch.allclose(R @ R.mT, torch.eye(3).double(), atol=1e-12)
    assert torch.equal(ik.Inverter(ROBOT, reference=T[3]).fit(T, q).reference, T[3])


def test_fitting_keeps_the_weights_and_the_seed_makes_them():
    before = ik.Inverter(ROBOT, seed=4).network.weights[0].detach().clone()
    assert torch.equal(fitted(seed=4).network.weights[0], before)
    assert not torch.equal(fitted(seed=5).network.weights[0], before)


def test_a_bounded_inverter_never_leaves_the_limits():
    inverter = fitted(bounded=True)
    with torch.no_grad():
        for weight in inverter.network.parameters():
            weight.mul_(1e3)
    q = inverter(data(500, seed=2)[0])
    assert ((q >= ROBOT.q_min) & (q <= ROBOT.q_max)).all()
    assert (q == ROBOT.q_max).any()
    assert (q == ROBOT.q_min).any()


def test_bounded_needs_limits():
    free = ik.Robot.from_dh([{"a": 1.0}, {"a": 1.0}], convention="standard", name="free")
    with pytest.raises(ik.RobotError, match="robot 'free': bounded needs limits, but joint_1, joint_2 has none"):
        ik.Inverter(free, bounded=True)


@pytest.mark.parametrize("lead", [(), (3,)])
def test_a_rollout_feeds_its_own_answers_back(lead: tuple[int, ...]):
    inverter = fitted(feedback=True)
    T, q, _ = data(6)
    with torch.no_grad():
        answers = inverter.rollout(T, q[0].expand(*lead, 6))
        now = q[0].expand(*lead, 6)
        for k in range(6):
            now = inverter(T[k], now)
            assert torch.allclose(answers[k], now, atol=1e-13)
    assert answers.shape == (6, *lead, 6)


def test_a_traditional_rollout_is_its_answers():
    inverter = fitted()
    T, q, _ = data(6)
    assert torch.equal(inverter.rollout(T, q[0]), inverter(T))
    assert torch.equal(inverter.rollout(T, q[:2])[:, 1], inverter(T))


def test_gradients_flow_to_poses_joints_and_weights():
    inverter = fitted(feedback=True, hidden=(4,))
    T, _, now = data(3)

    def answer(position: Tensor, now: Tensor) -> Tensor:
        moved = torch.cat([torch.cat([T[:, :3, :3], position[..., None]], -1), T[:, 3:]], -2)
        return inverter(moved, now)

    inputs = (T[:, :3, 3].clone().requires_grad_(), now.requires_grad_())
    assert torch.autograd.gradcheck(answer, inputs)
    answer(*inputs).sum().backward()
    assert all(weight.grad.abs().sum() > 0 for weight in inverter.network.parameters())


def test_float32_on_demand_and_nothing_silent():
    inverter = fitted(dtype=torch.float64).to(torch.float32)
    T, _, _ = data(4)
    assert inverter(T.float()).dtype == torch.float32
    with pytest.raises(ik.ShapeError, match=r"T must be torch.float32 like the inverter, got torch.float64"):
        inverter(T)


def test_mismatched_calls_are_refused():
    T, q, now = data()
    with pytest.raises(ik.ShapeError, match=r"give the present joints, inverter\(T, q_current\)"):
        fitted(feedback=True)(T)
    with pytest.raises(ik.ShapeError, match="does not look at the present joints"):
        fitted()(T, now)
    with pytest.raises(ik.ShapeError, match=r"q_current must have shape \(\.\.\., 6\)"):
        fitted(feedback=True)(T, now[:, :5])
    with pytest.raises(ik.ShapeError, match="T and q must have the same rows"):
        ik.Inverter(ROBOT).fit(T[:5], q)
    with pytest.raises(ik.DataError, match="the data set is empty"):
        ik.Inverter(ROBOT).fit(T[:0], q[:0])
    q[3, 2] = torch.nan
    with pytest.raises(ik.DataError, match=r"q\[3, 2\] is nan; the data must be finite"):
        ik.Inverter(ROBOT).fit(T, q)
