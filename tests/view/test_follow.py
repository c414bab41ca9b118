"""The methods that follow a target: what they reach, what they say, and that none is helped."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

import ikgrad as ik
from ikgrad.view import Session
from ikgrad.view.follow import CORRECTIONS, PATIENCE, PORTION, Network, methods
from ikgrad.view.race import inverter_for

ALL = [
    "Levenberg-Marquardt",
    "Newton-Raphson",
    "APPS",
    "neural inverter",
    f"neural inverter + {CORRECTIONS} damped steps",
]


@pytest.fixture(scope="module")
def ur5e() -> ik.Robot:
    return ik.load_robot("ur5e")


@pytest.fixture
def session(ur5e: ik.Robot) -> Callable[[str], Session]:
    """A session that follows with a method."""

    def make(name: str) -> Session:
        session = Session(ur5e)
        session.method = methods(inverter_for(ur5e))[name]
        return session

    return make


def test_the_default_comes_first_and_an_inverter_only_where_there_is_one(ur5e: ik.Robot):
    assert list(methods(inverter_for(ur5e))) == ALL
    assert list(methods()) == ALL[:3]


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("thorough", [True, False])
def test_a_target_nearby_is_reached_or_neared_and_the_errors_are_measured(
    session: Callable[[str], Session], ur5e: ik.Robot, name: str, thorough: bool
):
    one = session(name)
    T = ik.forward_kinematics(ur5e, one.home + 0.03)
    before = float((T - one.T_target)[:3, 3].norm())
    answer = one.reach(T, thorough=thorough)
    e = ik.pose_error(ik.forward_kinematics(ur5e, answer.q), T)
    assert answer.position_error == pytest.approx(float(e[:3].norm()), abs=1e-12)
    assert answer.rotation_error == pytest.approx(float(e[3:].norm()), abs=1e-7)
    assert answer.position_error < before
    assert answer.success == (answer.position_error <= 1e-6 and answer.rotation_error <= 1e-6)
    assert answer.success or name == "APPS" or answer.near
    assert torch.equal(one.q, answer.q)


@pytest.mark.parametrize("name", ALL)
def test_out_of_reach_is_said_whatever_the_method(session: Callable[[str], Session], name: str):
    one = session(name)
    T = one.T_target.clone()
    T[:3, 3] *= 20
    answer = one.reach(T)
    assert (answer.success, answer.reason, answer.more, answer.near) == (False, "unreachable", False, False)
    assert answer.words.startswith("out of reach: ")


@pytest.mark.parametrize("name", ALL)
def test_no_transform_moves_nothing(session: Callable[[str], Session], name: str):
    one = session(name)
    answer = one.reach(torch.full((4, 4), torch.nan, dtype=torch.float64))
    assert answer.words == "the target is no rigid transform"
    assert torch.equal(one.q, one.home)


def test_apps_goes_on_from_where_it_is_until_its_patience_ends(session: Callable[[str], Session], ur5e: ik.Robot):
    """In portions it comes to exactly where one run of as many gradients comes."""
    one = session("APPS")
    T = ik.forward_kinematics(ur5e, one.home + 0.3)
    first = one.reach(T)
    assert first.more
    assert f"is on its way after {PORTION} gradients; missing" in first.words
    second = one.reach(T)
    assert f"after {2 * PORTION} gradients" in second.words
    whole = ik.solve_ik(ur5e, T, q0=one.home, solver=ik.Apps(max_steps=2 * PORTION + 1))
    assert torch.allclose(second.q, whole.q, atol=1e-12)
    answers = [second]
    while answers[-1].more:
        answers.append(one.reach(T))
    assert len(answers) + 1 <= -(-PATIENCE // PORTION)
    assert answers[-1].success or "has not arrived after 1,0" in answers[-1].words
    assert f"after {PORTION} gradients" in one.reach(ik.forward_kinematics(ur5e, one.home)).words  # a new count


def test_newton_raphson_stays_lost_and_says_so(session: Callable[[str], Session], ur5e: ik.Robot):
    one = session("Newton-Raphson")
    lost = []
    for target in ik.sample_configurations(ur5e, 30, seed=1):
        one.reset()
        answer = one.reach(ik.forward_kinematics(ur5e, target))
        if answer.reason == "no_convergence":
            lost.append(answer.words)
    assert lost
    assert all(words.startswith("Newton-Raphson has not arrived after 100 steps") for words in lost)


def test_newton_raphson_does_not_know_limits():
    one = ik.Robot.from_dh([{"a": 1.0}], convention="standard", q_min=[-1.0], q_max=[1.0], name="hand of a clock")
    session = Session(one, position_only=False)
    session.method = methods()["Newton-Raphson"]
    answer = session.reach(ik.forward_kinematics(one, torch.tensor([2.0]).double()))
    assert (answer.success, answer.reason) == (False, "joint_limits")
    assert "with a joint outside its limits, which this method does not know" in answer.words


def test_damped_steps_bring_an_inverter_nearer(panda: ik.Robot):
    inverter = inverter_for(panda)
    home = Session(panda).home
    targets = ik.forward_kinematics(panda, home + 0.4 * torch.randn(20, 7, generator=torch.Generator().manual_seed(0)))
    errors = []
    for corrections in (0, CORRECTIONS):
        each = []
        for T in targets:
            q = Network(inverter, corrections)(panda, T, home, mask=None, thorough=False).q
            each.append(float(ik.pose_error(ik.forward_kinematics(panda, q), T).norm()))
        errors.append(sorted(each)[10])
    assert errors[1] < 0.1 * errors[0]


def test_examples_of_endlessly_many_solutions_lie_far_apart(panda: ik.Robot):
    session = Session(panda)
    found = session.solutions()
    assert len(found) == 8
    assert torch.allclose(found[0], session.q, atol=1e-4)
    T = ik.forward_kinematics(panda, found)
    assert torch.allclose(T, session.T_target.expand_as(T), atol=1e-5)
    apart = torch.cdist(found, found, p=float("inf")) + 9 * torch.eye(8)
    assert float(apart.min()) > 0.1  # the eight nearest ones are 0.01 apart
