"""The best of several answers: never worse than each, and without present joints."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.evaluation import measure
from ikgrad.networks import BestOfStarts, IncrementInverter, UnrolledInverter
from ikgrad.solvers.damped import damped_steps


def poses(robot: ik.Robot, count: int) -> torch.Tensor:
    return ik.forward_kinematics(robot, ik.sample_configurations(robot, count, seed=3))


@pytest.mark.parametrize("family", [IncrementInverter, UnrolledInverter], ids=lambda family: family.family)
def test_the_answer_is_the_best_of_the_single_ones(family: type[IncrementInverter], robot: ik.Robot):
    T = poses(robot, 40)
    best = BestOfStarts(family(robot, width=16, depth=2), starts=5)
    singles = torch.stack([best.inverter(T, start) for start in best.q_starts])
    missing = torch.stack([damped_steps(robot, T, q).error.norm(dim=-1) for q in singles])
    chosen = missing.argmin(dim=0)
    assert len(chosen.unique()) > 1
    torch.testing.assert_close(best(T), singles[chosen, torch.arange(40)], rtol=0, atol=1e-5)


def test_more_starts_solve_more(panda: ik.Robot):
    T = poses(panda, 300)
    close = [measure(panda, BestOfStarts(UnrolledInverter(panda), starts=k)(T), T).close for k in (1, 4, 16)]
    assert close[0] < close[1] < close[2]


def test_any_batch_shape_and_dtype_goes(panda: ik.Robot):
    best = BestOfStarts(UnrolledInverter(panda, width=8), starts=3)
    T = poses(panda, 6)
    assert best(T.view(3, 1, 2, 4, 4)).shape == (3, 1, 2, 7)
    assert best(T[0]).shape == (7,)
    assert best(T[:0]).shape == (0, 7)
    assert best(T.float()).dtype == torch.float32
    assert ik.solve_ik(panda, T, seeder=best).success.all()


def test_no_start_is_refused(panda: ik.Robot):
    with pytest.raises(ik.ConfigError, match="starts must be at least 1, got 0"):
        BestOfStarts(UnrolledInverter(panda), starts=0)
