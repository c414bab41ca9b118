"""`solve_ik` with a seeder: anything that guesses joints for poses."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.solvers.seeding import seeds


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("panda")


def poses(robot: ik.Robot, *shape: int) -> tuple[torch.Tensor, torch.Tensor]:
    q = ik.sample_configurations(robot, int(torch.Size(shape).numel()), seed=5).reshape(*shape, robot.dof)
    return q, ik.forward_kinematics(robot, q)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_a_seeder_starts_where_q0_would(robot, shape):
    q, T = poses(robot, *shape)
    there = q + 0.05
    a, b = ik.solve_ik(robot, T, seeder=lambda T: there), ik.solve_ik(robot, T, q0=there)
    assert torch.equal(a.q, b.q)
    assert torch.equal(a.steps, b.steps)
    assert a.success.all()


def test_the_nearest_of_several_guesses_is_taken(robot):
    q, T = poses(robot, 6)
    far = ik.sample_configurations(robot, 12, seed=8).reshape(6, 2, 7)
    guesses = torch.stack([far[:, 0], q + 0.01, far[:, 1]], dim=1)
    assert torch.equal(seeds(robot, T, lambda T: guesses), q + 0.01)
    assert torch.equal(seeds(robot, T[0], lambda T: guesses[0]), q[0] + 0.01)


def test_a_perfect_guess_takes_no_step(robot):
    q, T = poses(robot, 50)
    answer = ik.solve_ik(robot, T, seeder=lambda T: q)
    assert (answer.steps == 0).all()
    assert torch.equal(answer.q, q)


def test_a_guess_that_is_not_finite_does_not_fail_the_row(robot):
    q, T = poses(robot, 20)
    q[::2] = torch.nan
    q[3, 4] = torch.inf
    assert ik.solve_ik(robot, T, seeder=lambda T: q).success.all()


def test_an_inverter_seeds_in_its_own_dtype(robot):
    q, T = poses(robot, 50)
    inverter = ik.Inverter(robot, dtype=torch.float32).fit(T.float(), q.float())
    answer = ik.solve_ik(robot, T, seeder=inverter)
    assert answer.success.all()
    assert answer.q.dtype == torch.float64


def test_the_seeder_gets_no_gradient_and_the_answer_does(robot):
    q, T = poses(robot, 3)
    T.requires_grad_()
    answer = ik.solve_ik(robot, T, seeder=lambda T: (q + 0.1) if not T.requires_grad else pytest.fail("T has a graph"))
    answer.q.sum().backward()
    assert T.grad is not None
    assert T.grad.isfinite().all()


def test_other_methods_take_seeds_too(robot):
    q, T = poses(robot, 10)
    for solver in (ik.NewtonRaphson(), ik.LevenbergMarquardt(compiled=False)):
        assert ik.solve_ik(robot, T, solver=solver, seeder=lambda T: q + 0.02).success.all()


def test_the_table_saves_steps_and_loses_nothing(robot):
    _, T = poses(robot, 2000)
    table, random = (ik.solve_ik(robot, T, solver=ik.LevenbergMarquardt(table=on)) for on in (True, False))
    assert table.success.all()
    assert random.success.all()
    assert 2 * table.steps.sum() < random.steps.sum()


@pytest.mark.parametrize("wrong", [(5, 6), (4, 7), (5, 0, 7), (5, 2, 6), (7,)])
def test_a_wrong_shape_is_refused(robot, wrong):
    _, T = poses(robot, 5)
    with pytest.raises(
        ik.ShapeError, match=r"the seeder returned .* expected \(5, 7\), or k guesses each, \(5, 'k', 7\)"
    ):
        ik.solve_ik(robot, T, seeder=lambda T: torch.zeros(wrong))


def test_a_seeder_of_another_robot_is_refused(robot):
    _, T = poses(robot, 5)
    inverter = ik.Inverter(ik.load_robot("iiwa14"))
    with pytest.raises(ik.RobotError, match=r"the seeder is for robot 'iiwa14' .*, not 'panda'"):
        ik.solve_ik(robot, T, seeder=inverter)


def test_an_inverter_from_the_present_joints_gets_q0_or_the_middle(robot):
    q, T = poses(robot, 2, 5)
    there = (q + 0.1).clamp(robot.q_min, robot.q_max)
    inverter = ik.load_inverter("panda")
    answer = ik.solve_ik(robot, T, q0=there, seeder=inverter)
    assert answer.success.all()
    with torch.no_grad():
        assert torch.equal(answer.q, ik.solve_ik(robot, T, q0=inverter(T, there)).q)
        middle = ((robot.q_min + robot.q_max) / 2).expand_as(q)
        assert torch.equal(seeds(robot, T, inverter), inverter(T, middle))
    assert answer.steps.sum() < ik.solve_ik(robot, T, q0=there).steps.sum()


def test_two_starts_are_refused(robot):
    q, T = poses(robot, 5)
    with pytest.raises(ik.ConfigError, match=r"give q0 or a seeder, not both: .* this seeder does not look at q0"):
        ik.solve_ik(robot, T, q0=q, seeder=lambda T: q)
