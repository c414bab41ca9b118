"""Protocols: an oracle has no error, errors are those of another library's FK, and jumps are counted."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

import ikgrad as ik
from ikgrad.data.paths import straight_lines
from ikgrad.evaluation import PROTOCOLS, Evaluation, Global, IKFlow, Line, Local, Path, Protocol, TracIK
from ikgrad.evaluation.paths import JUMP, POINTS
from ikgrad.solvers.damped import damped_steps

FEW = dict(solver_steps=1, plain_steps=(1,))
SMALL = {"local": 60, "global": 60, "ikflow": 4, "tracik": 30, "path": POINTS, "line": POINTS}


class Stub(nn.Module):
    """An inverter made of a function; with or without present joints."""

    def __init__(self, robot: ik.Robot, answer: Callable[..., Tensor], *, feedback: bool = True):
        super().__init__()
        self.robot, self.answer, self.feedback = robot, answer, feedback

    def forward(self, *given: Tensor) -> Tensor:
        return self.answer(*given)


def solver(robot: ik.Robot, *, feedback: bool = True) -> Stub:
    """An oracle: the exact solver, from the present joints or from its own starts."""
    return Stub(robot, lambda T, q=None: ik.solve_ik(robot, T, q0=q, tol_pos=1e-9, tol_rot=1e-9).q, feedback=feedback)


def run(inverter: nn.Module, name: str, **settings: int) -> Evaluation:
    return ik.evaluate(inverter, PROTOCOLS[name](**{"count": SMALL[name], **settings}), **FEW)


def numbers(found: Evaluation) -> dict:
    """The record without times."""
    record = found.record()
    for row in record["rows"]:
        del row["microseconds"]
        row["extra"].pop("time_ratio", None)
    record["rows"] = [row for row in record["rows"] if "in the same time" not in row["method"]]
    return record


@pytest.mark.parametrize("feedback", [True, False])
@pytest.mark.parametrize("name", PROTOCOLS)
def test_an_oracle_has_no_error(name: str, feedback: bool, panda: ik.Robot):
    found = run(solver(panda, feedback=feedback), name)
    mine = next(row for row in found.rows if "inverter" in row.method)
    assert mine.errors.close == 1.0
    assert mine.errors.inside == 1.0
    assert mine.extra.get("solved", 1.0) == 1.0
    assert mine.microseconds > 0


@pytest.mark.parametrize("name", ["local", "global", "ikflow", "path", "line"])
def test_errors_are_those_of_another_librarys_kinematics(name: str, panda: ik.Robot):
    found = run(ik.UnrolledInverter(panda, rounds=1, width=8), name)
    T = panda.chain.forward_kinematics(found.answers.q).get_matrix()
    target = found.answers.T_target
    assert len(T) == len(target) == found.count
    mm = 1e3 * (T[:, :3, 3] - target[:, :3, 3]).norm(dim=-1)
    errors = found.rows[0].errors
    assert errors.mean_position_mm == pytest.approx(float(mm.mean()), rel=1e-6)
    assert errors.position_mm[0] == pytest.approx(float(mm.sort().values[len(mm) // 2]), rel=1e-6)
    trace = (T[:, :3, :3] * target[:, :3, :3]).sum(dim=(1, 2))
    deg = ((trace - 1) / 2).clamp(-1, 1).acos().rad2deg()
    assert errors.mean_rotation_deg == pytest.approx(float(deg.mean()), rel=1e-4)
    close = (mm <= 1) & (deg <= 0.01 * 180 / torch.pi)
    assert errors.close == pytest.approx(float(close.double().mean()))  # its answers are inside the limits


@pytest.mark.parametrize("name", PROTOCOLS)
def test_the_seed_decides(name: str):
    inverter = ik.UnrolledInverter(ik.load_robot("ur5e"), rounds=1, width=8)
    first, again, other = (numbers(run(inverter, name, seed=seed)) for seed in (3, 3, 4))
    assert first == again
    assert first["rows"] != other["rows"]
    assert json.loads(json.dumps(first))["protocol"] == name


def test_rows_are_not_those_of_a_training(panda: ik.Robot):
    found = Local(count=50).run(solver(panda), **FEW)
    trained = ik.data.TaskStream(panda, batch_size=50).batch(0).T
    assert not torch.isclose(found.answers.T_target[:, 0, 3], trained[:, 0, 3]).any()


def test_counts_are_what_was_asked_for(panda: ik.Robot):
    near, blind = solver(panda), solver(panda, feedback=False)
    assert [run(near, name).count for name in SMALL] == [60, 60, 200, 30, 200, 200]
    assert run(blind, "ikflow").count == 4
    assert Path(count=2 * POINTS + 1).run(near, **FEW).count == 2 * POINTS
    for protocol, count in ((Local, 10_000), (Global, 10_000), (IKFlow, 500), (TracIK, 10_000), (Path, 10_000)):
        assert protocol.poses == count


def test_the_tables_say_what_they_hold(panda: ik.Robot):
    inverter = ik.UnrolledInverter(panda, width=8)
    found = ik.evaluate(inverter, Local(count=50))
    names = [row.method for row in found.rows]
    assert names[:4] == ["inverter", "inverter + 1 step", "inverter + 2 steps", "inverter + 3 steps"]
    assert names[4:10] == [f"plain, {k} step{'s' * (k > 1)}" for k in (1, 2, 3, 4, 6, 8)]
    assert "panda, task local, 0.5 rad, 50 poses, seed 0, 1 thread" in found.lines()[0]
    assert "| mean [mm] | mean [deg] |" in run(inverter, "ikflow").lines()[2]
    head = run(inverter, "path").lines()[2]
    assert "| 1 mm, 0.01 rad | reconfigurations | largest jump [rad] | us a pose |" in head
    head = run(inverter, "tracik").lines()[2]
    assert head == "| method | solved | steps, mean / 99 % | us a pose | of the engine's time |"


def test_numbers_of_others_are_quoted_for_their_robot_alone(panda: ik.Robot):
    mine, other = (run(ik.UnrolledInverter(robot, width=8), "ikflow") for robot in (panda, ik.load_robot("ur5e")))
    assert mine.published["mean_position_mm"] == 6.66
    assert "IKFlow: mean 6.66 mm and 2.03 deg, published, not measured here" in mine.notes[0]
    assert (other.published, other.notes) == ({}, ())
    blind = run(solver(panda, feedback=False), "ikflow")
    assert blind.notes[0] == "The inverter does not look at the present joints: one answer a pose."
    assert "99.70 % solved in 0.38 ms" in run(solver(panda), "tracik").notes[0]


# ---------------------------------------------------------------- starts of the solver


def test_a_perfect_start_leaves_nothing_to_do(panda: ik.Robot):
    own, middle, mine = TracIK(count=40).run(solver(panda, feedback=False)).rows
    assert (own.method, middle.method) == ("solve_ik, its own starts", "solve_ik from the middle of the ranges")
    assert mine.extra["steps"] == 0.0
    assert own.extra["steps"] > 1
    assert own.extra["time_ratio"] == 1.0


def test_what_the_solver_says_of_itself_is_not_looked_at(panda: ik.Robot, monkeypatch: pytest.MonkeyPatch):
    def boaster(robot, T, **options):
        honest = ik.solve_ik(robot, T, **options)
        return type(honest)(honest.q + 1e-4, torch.ones_like(honest.success), *list(vars(honest).values())[2:])

    monkeypatch.setattr("ikgrad.evaluation.tracik.solve_ik", boaster)
    assert [row.extra["solved"] for row in run(solver(panda), "tracik").rows] == [0.0] * 3


# ---------------------------------------------------------------- paths


def test_every_answer_is_the_present_joints_of_the_next_pose(panda: ik.Robot):
    asked: list[tuple[Tensor, Tensor]] = []

    def answer(T: Tensor, q: Tensor) -> Tensor:
        asked.append((q.clone(), damped_steps(panda, T, q, steps=3).q))
        return asked[-1][1]

    found = Line(count=2 * POINTS).run(Stub(panda, answer), solver_steps=0, plain_steps=())
    rounds = len(asked) // POINTS
    assert rounds * POINTS == len(asked)
    for k in range(1, POINTS):
        assert torch.equal(asked[k][0], asked[k - 1][1])
    lines = straight_lines(panda, 2, POINTS, 2**31 - 1)
    assert torch.equal(asked[0][0], lines.q[:, 0])
    assert torch.equal(found.answers.T_target, lines.T.flatten(0, 1))


def test_jumps_are_counted(panda: ik.Robot):
    """To and fro by 0.5 rad in the first joint, at every second point."""
    calls = 0

    def answer(T: Tensor, q: Tensor) -> Tensor:
        nonlocal calls
        calls += 1
        return torch.zeros(len(T), 7).double() + torch.tensor([0.5 * (calls % 2), 0, 0, -1, 0, 1, 0])

    found = Path(count=2 * POINTS).run(Stub(panda, answer), solver_steps=0, plain_steps=())
    assert found.rows[0].extra == {
        "reconfigurations": 2 * (POINTS - 1),
        "paths_with_one": 1.0,
        "largest_jump": pytest.approx(0.5),
    }
    assert f"moves by more than {JUMP:g} rad" in found.notes[0]


def test_followers_do_not_jump_on_lines_and_strangers_do(panda: ik.Robot):
    follower = run(Stub(panda, lambda T, q: damped_steps(panda, T, q, steps=8).q), "line").rows[0]
    stranger = run(solver(panda, feedback=False), "line").rows[0]
    assert (follower.extra["reconfigurations"], follower.errors.exact) == (0, 1.0)
    assert follower.extra["largest_jump"] < 0.1
    assert stranger.extra["reconfigurations"] > 3


def test_an_answer_that_is_lost_counts_as_a_jump_and_the_arm_stays(panda: ik.Robot):
    calls = 0

    def answer(T: Tensor, q: Tensor) -> Tensor:
        nonlocal calls
        assert q.isfinite().all()
        calls += 1
        return damped_steps(panda, T, q, steps=8).q * (torch.nan if calls % POINTS == 7 else 1.0)

    row = Line(count=POINTS).run(Stub(panda, answer), solver_steps=0, plain_steps=()).rows[0]
    assert row.extra["reconfigurations"] == 2  # there and back
    assert row.extra["largest_jump"] == float("inf")
    assert row.errors.position_mm[2] == float("inf")
    assert row.errors.exact == pytest.approx(1 - 1 / POINTS)


def test_whole_turns_count_unless_the_joint_has_no_limit():
    for name, jumps in (("ur5e", POINTS - 1), ("arm4", 0)):  # arm4 turns for ever, ur5e up to two turns
        robot = ik.load_robot(name)
        calls = 0

        def answer(T: Tensor, q: Tensor) -> Tensor:
            nonlocal calls
            calls += 1
            q = torch.zeros_like(q)
            q[:, 0] = torch.pi if calls % 2 else -torch.pi
            return q

        row = Path(count=POINTS).run(Stub(robot, answer), solver_steps=0, plain_steps=()).rows[0]
        assert row.extra["reconfigurations"] == jumps


# ---------------------------------------------------------------- what does not fit


def test_settings_out_of_range_are_refused():
    for protocol in PROTOCOLS.values():
        with pytest.raises(ik.ConfigError, match="count must be at least 1, or 0 for the protocol's own, got -1"):
            protocol(count=-1)
        with pytest.raises(ik.ConfigError, match=r"seed must be in \[0, 2\^31\), got -2"):
            protocol(seed=-2)


@pytest.mark.parametrize("name", ["local", "ikflow", "path"])
def test_negative_steps_are_refused(name: str, panda: ik.Robot):
    protocol: Protocol = PROTOCOLS[name](count=4)
    with pytest.raises(ik.ConfigError, match=r"numbers of steps must not be negative, got 1 and \(-1,\)"):
        protocol.run(solver(panda), solver_steps=1, plain_steps=(-1,))


def test_a_short_arm_follows_no_straight_line():
    with pytest.raises(ik.RobotError, match="robot 'arm4' can follow only 0 of 8 random straight lines, 1 wanted"):
        run(ik.UnrolledInverter(ik.load_robot("arm4"), width=8), "line")
