"""A row's answer is its own: bit for bit the same alone, in any batch, order, split, on any number of threads."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import ikgrad as ik
from ikgrad.collision import Spheres, clearance_residual

FIELDS = ("q", "success", "reason_code", "position_error", "rotation_error", "steps")


@pytest.fixture(params=["panda", "kr210"])
def goals(request: pytest.FixtureRequest) -> tuple[ik.Robot, torch.Tensor]:
    """3,000 poses, some of them hard, some unreachable, some no poses at all."""
    robot = ik.load_robot(request.param)
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 3000, seed=11))
    T[::50, :3, 3] += 0.3 * robot.length
    T[7::400, :3, :3] *= 1.5
    return robot, T


def same(a: ik.IKSolution, b: ik.IKSolution) -> bool:
    return all(torch.equal(getattr(a, f).nan_to_num(-1.0), getattr(b, f).nan_to_num(-1.0)) for f in FIELDS)


def take(solution: ik.IKSolution, rows: torch.Tensor) -> ik.IKSolution:
    return ik.IKSolution(*(getattr(solution, f)[rows] for f in FIELDS))


@pytest.mark.parametrize("start", [False, True], ids=["cold", "q0"])
def test_answers_do_not_depend_on_the_batch(goals: tuple[ik.Robot, torch.Tensor], start: bool):
    robot, T = goals
    q0 = ik.sample_configurations(robot, len(T), seed=12) if start else None

    def solve(rows: torch.Tensor) -> ik.IKSolution:
        return ik.solve_ik(robot, T[rows], q0=None if q0 is None else q0[rows], seed=5)

    everything = torch.arange(len(T))
    whole = solve(everything)
    assert len(whole.counts()) >= 3
    order = torch.randperm(len(T), generator=torch.Generator().manual_seed(0))
    assert same(solve(order), take(whole, order))
    assert same(solve(everything[1234:2345]), take(whole, everything[1234:2345]))
    for size in (1, 7, 8, 9, 333):
        rows = everything[600 : 600 + size]
        assert same(solve(rows), take(whole, rows))
    for row in (0, 7, 50, 1999):
        alone = ik.solve_ik(robot, T[row], q0=None if q0 is None else q0[row], seed=5)
        assert same(alone, take(whole, torch.tensor(row)))


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_answers_with_a_second_wish_do_not_depend_on_the_batch(name: str):
    robot = ik.load_robot(name)
    q = ik.sample_configurations(robot, 60, seed=3)
    ball = Spheres(torch.tensor([[0.4, 0.1, 0.4], [-0.3, 0.3, 0.5]]).double(), torch.tensor([0.15, 0.15]).double())
    wish = clearance_residual(robot, ball, margin=0.02, link_radius=0.05)
    T = ik.forward_kinematics(robot, q)
    whole = ik.solve_ik(robot, T, extra_residual=wish, seed=5)
    assert bool((whole.steps > whole.steps.min()).any())
    order = torch.randperm(60, generator=torch.Generator().manual_seed(0))
    assert same(ik.solve_ik(robot, T[order], extra_residual=wish, seed=5), take(whole, order))
    for size in (1, 7, 9):
        rows = torch.arange(20, 20 + size)
        assert same(ik.solve_ik(robot, T[rows], extra_residual=wish, seed=5), take(whole, rows))
    assert same(ik.solve_ik(robot, T[4], extra_residual=wish, seed=5), take(whole, torch.tensor(4)))


def test_answers_do_not_depend_on_the_threads(goals: tuple[ik.Robot, torch.Tensor]):
    robot, T = goals
    before = torch.get_num_threads()
    answers = []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            answers.append(ik.solve_ik(robot, T.repeat(4, 1, 1)))
    finally:
        torch.set_num_threads(before)
    assert same(answers[0], answers[1])
    assert same(answers[0], answers[2])


def test_several_python_threads_may_solve_at_once(goals: tuple[ik.Robot, torch.Tensor]):
    robot, T = goals
    expected = ik.solve_ik(robot, T)
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda _: ik.solve_ik(robot, T), range(12)))
    assert all(same(answer, expected) for answer in answers)


def _in_child(T: torch.Tensor) -> list[float]:
    torch.set_num_threads(1)  # torch's own pool does not survive a fork
    return ik.solve_ik(ik.load_robot("kr210"), T).q.flatten().tolist()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_solves_the_same():
    robot = ik.load_robot("kr210")
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 3, seed=1))
    expected = ik.solve_ik(robot, T).q.flatten().tolist()
    with multiprocessing.get_context("fork").Pool(2) as pool:
        answers = pool.map_async(_in_child, [T, T]).get(timeout=120)
    assert answers == [expected, expected]


def test_negative_zero_is_zero():
    robot = ik.load_robot("panda")
    T = torch.eye(4, dtype=torch.float64)
    T[0, 3], T[2, 3] = 0.5, 0.4
    minus = torch.where(T == 0, -0.0, T)
    assert same(ik.solve_ik(robot, T), ik.solve_ik(robot, minus))
