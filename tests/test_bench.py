"""Benchmarks: the judge, statistics, targets, races, adapters and the command, on tiny sizes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.bench import ik as bench_ik_module
from ikgrad.bench import targets
from ikgrad.bench.boxes import solvable_nearby
from ikgrad.bench.ik import Plan, bench_ik
from ikgrad.bench.judge import into_range, judge
from ikgrad.bench.kinematics import bench_kinematics
from ikgrad.bench.path import bench_paths
from ikgrad.bench.peers import PEERS, peers
from ikgrad.bench.peers.base import Peer, Question, UnsupportedError, check_same_robot
from ikgrad.bench.peers.chain import limited, rpy, urdf_text, z_chain, zero_axes
from ikgrad.bench.peers.ours import Ikgrad
from ikgrad.bench.protocols import PROTOCOLS
from ikgrad.bench.race import Runner, race
from ikgrad.bench.run import Request
from ikgrad.bench.statistics import median_interval, paired_ratio, percentile
from ikgrad.bench.watch import run_python
from ikgrad.cli.main import main
from ikgrad.errors import ConfigError, RobotError, ShapeError, UnknownNameError

TINY = Plan(rows=12, rounds=2, seconds=0.05)


class FakePeer(Peer):
    """Answers with joints that it was given beforehand, and claims that they are right."""

    name, package, module = "fake", "ikgrad", "ikgrad"

    def __init__(self, answers: np.ndarray):
        self.answers, self.asked = answers, 0

    def prepare(self, robot: ik.Robot, question: Question) -> None:
        self.rows = {T.tobytes(): k for k, T in enumerate(self.poses)}

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        return self.answers[self.rows[T.tobytes()]]


def race_against(robot: ik.Robot, change: np.ndarray) -> bench_ik_module.Cell:
    """A peer that knows the answers, and changes them before it hands them out."""
    q = ik.sample_configurations(robot, TINY.rows, seed=TINY.seed).numpy()
    peer = FakePeer(q + change)
    peer.poses = targets.reachable(robot, TINY.rows, TINY.seed).numpy()
    return bench_ik(robot, PROTOCOLS["tight"], TINY, [peer])[1]


def test_judge_accepts_the_truth_and_refuses_lies(panda: ik.Robot):
    q = ik.sample_configurations(panda, 6, seed=0)
    T = ik.forward_kinematics(panda, q)
    q[1, 0] += 1e-4  # a wrong pose
    q[2] = math.nan  # no answer
    q[3, 6] += 1e-12  # rounding
    verdict = judge(panda, q, T, tol_pos=1e-6, tol_rot=1e-6)
    assert verdict.solved.tolist() == [True, False, False, True, True, True]
    assert verdict.position_error[2].isnan()
    assert not verdict.inside[2]


def test_judge_adds_whole_turns_and_refuses_joints_outside_the_limits(panda: ik.Robot):
    q = ik.sample_configurations(panda, 3, seed=0)
    T = ik.forward_kinematics(panda, q)
    turned = q + 2 * math.pi * torch.tensor([1.0, 0, -2, 0, 0, 0, 3])
    assert judge(panda, turned, T, tol_pos=1e-6, tol_rot=1e-6).solved.all()
    outside = q.clone()
    outside[:, 3] = 0.5  # the elbow bends one way only; no turn helps
    verdict = judge(panda, outside, ik.forward_kinematics(panda, outside), tol_pos=1e-6, tol_rot=1e-6)
    assert not verdict.solved.any()
    assert not verdict.inside.any()
    assert verdict.position_error.max() < 1e-9  # right pose all the same


def test_turns_leave_slides_and_geared_joints_alone(zoo_path):
    zoo = ik.load_robot(zoo_path, tip="hand")  # a continuous joint with a mimic at -0.5, a slide, a limited wrist
    q = torch.tensor([[7.0, 9.0, 2.1]], dtype=torch.float64)
    assert into_range(zoo, q).tolist() == [[7.0, 9.0, 2.1]]
    assert into_range(zoo, torch.tensor([[0.0, 0.0, 6.28]], dtype=torch.float64))[0, 2].abs() < 0.01


def test_judge_wants_an_answer_for_every_pose(panda: ik.Robot):
    with pytest.raises(ShapeError, match=r"answers must have shape \(2, 7\), got \(2, 6\)"):
        judge(panda, torch.zeros(2, 6), torch.eye(4).expand(2, 4, 4).double(), tol_pos=1e-6, tol_rot=1e-6)


@pytest.mark.parametrize(
    ("change", "solved", "outside"),
    [(0.0, True, 0), (1e-3, False, None), (2 * math.pi, True, 0), (math.nan, False, 0)],
)
def test_a_lying_peer_is_caught(panda: ik.Robot, change: float, solved: bool, outside: int | None):
    cell = race_against(panda, np.full(7, change))
    assert cell.solved == (cell.rows if solved else 0)
    assert outside is None or cell.outside == outside


def test_a_peer_outside_the_limits_is_caught():
    wide = ik.load_robot("ur5e")
    narrow = limited(wide)
    narrow = ik.Robot(
        narrow.name,
        narrow.base,
        narrow.segments,
        tuple(v._replace(q_min=-1.0, q_max=1.0) for v in narrow.variables),
    )
    q = ik.sample_configurations(narrow, 5, seed=0)
    q[:, 0] = 1.5
    verdict = judge(narrow, q, ik.forward_kinematics(narrow, q), tol_pos=1e-6, tol_rot=1e-6)
    assert not verdict.solved.any()


def test_a_peer_with_another_robot_is_refused(panda: ik.Robot):
    class Another(Ikgrad):
        def fk(self, q: np.ndarray) -> np.ndarray:
            return super().fk(q) + 1e-6

    peer = Another()
    peer.prepare(panda, Question())
    with pytest.raises(UnsupportedError, match="forward kinematics differs from ours by 1e-06"):
        check_same_robot(peer, panda)


def test_intervals_hold_the_estimate():
    samples = np.random.default_rng(1).normal(10, 1, 200)
    interval = median_interval(samples)
    assert interval.low < interval.value < interval.high
    assert interval.high - interval.low < 0.6
    assert paired_ratio(3 * samples, samples).low == pytest.approx(3)
    assert math.isnan(percentile([math.nan], 50))


def test_targets_are_what_they_say(panda: ik.Robot):
    q = targets.singular_configurations(panda, 20, 0)
    assert (targets.smallest_singular_value(panda, q) < 1e-3).all()
    assert ((q >= panda.q_min) & (q <= panda.q_max)).all()
    assert torch.equal(q, targets.singular_configurations(panda, 20, 0))
    paths = targets.smooth_paths(panda, 3, 200, 0)
    assert ((paths > panda.q_min) & (paths < panda.q_max)).all()
    assert paths.diff(dim=1).abs().max() < 0.15
    clear = targets.clear_paths(panda, 3, 200, 0)
    assert clear.shape == (3, 200, 7)
    assert ((clear > panda.q_min) & (clear < panda.q_max)).all()
    assert (targets.smallest_singular_value(panda, clear.flatten(0, 1)) > 0.01).all()


def test_unreachable_poses_are_outside_but_not_by_much(panda: ik.Robot):
    T = targets.unreachable(panda, 50, 0)
    shoulder = panda.tables().origins[0, :3, 3]
    away = (T[:, :3, 3] - shoulder).norm(dim=-1)
    radius = targets.workspace_radius(panda)
    assert radius < panda.reach_bound
    assert ((away >= radius + 0.2 - 1e-9) & (away <= radius + 2 + 1e-9)).all()
    assert not ik.solve_ik(panda, T).success.any()


def test_a_short_arm_has_no_singular_protocol():
    with pytest.raises(RobotError, match="4 joints: its Jacobian is singular everywhere"):
        targets.singular(ik.load_robot("arm4"), 5, 0)


def test_a_race_gives_everybody_the_same_number_of_turns():
    order: list[str] = []

    def work(name: str):
        def run(rows: slice) -> np.ndarray:
            order.append(name)
            return np.arange(rows.start, rows.stop, dtype=float)[:, None]

        return run

    ours, theirs = Runner("a", work("a"), 10, 4, everything=True), Runner("b", work("b"), 10, 1)
    race([ours, theirs], rounds=3, budget=1e-6)
    assert len(ours.seconds) == len(theirs.seconds) == 3
    rows, answers = ours.gathered(1)
    assert rows.tolist() == answers[:, 0].tolist() == list(range(10))  # every row, whatever the budget
    rows, answers = theirs.gathered(1)
    assert rows.tolist() == answers[:, 0].tolist()
    turns = "".join(order).lstrip("a").lstrip("b")  # without the warm-up, which ends with b
    assert turns.count("ab") == 3  # a, b, a, b, a, b: the machine is as busy for the one as for the other


def test_other_packages_get_the_same_chain(robot: ik.Robot, tmp_path):
    try:
        chain = z_chain(robot)
    except UnsupportedError as error:
        assert "mimic" in str(error)  # noqa: PT017
        return
    path = tmp_path / "chain.urdf"
    path.write_text(urdf_text(chain))
    q = ik.sample_configurations(robot, 10, seed=0)
    T = ik.forward_kinematics(robot, q)
    assert torch.allclose(ik.forward_kinematics(ik.load_robot(path, tip="tip"), q), T, rtol=0, atol=1e-12)
    axes, steps, R = zero_axes(chain)
    zero = ik.forward_kinematics(robot, torch.zeros(1, robot.dof).double())[0].numpy()
    assert np.allclose(steps.sum(axis=0), zero[:3, 3], rtol=0, atol=1e-12)
    assert np.allclose(R, zero[:3, :3], rtol=0, atol=1e-12)
    assert np.allclose(axes, ik.jacobian(robot, torch.zeros(robot.dof).double())[3:].T, rtol=0, atol=1e-12)


def test_rpy_holds_where_the_pitch_is_90_degrees():
    for roll, pitch, yaw in ((0.3, math.pi / 2, 0.0), (0.3, -math.pi / 2, 0.7), (1.0, 0.2, -3.0)):
        R = _rotation(roll, pitch, yaw)
        assert np.allclose(_rotation(*rpy(R)), R, rtol=0, atol=1e-12)


def _rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    def turn(axis: int, angle: float) -> np.ndarray:
        R, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
        R[i, i] = R[j, j] = math.cos(angle)
        R[j, i], R[i, j] = math.sin(angle), -math.sin(angle)
        return R

    return turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)


@pytest.mark.parametrize("adapter", PEERS, ids=lambda adapter: adapter.name)
def test_adapters_answer_or_say_why_not(adapter: type[Peer]):
    if not adapter.installed():
        assert "not installed" in adapter().available(ik.load_robot("ur5e"), next(iter(adapter.jobs)))
        pytest.skip("not installed")
    robot = ik.load_robot("ur5e")
    q = ik.sample_configurations(robot, 3, seed=5)
    T = ik.forward_kinematics(robot, q)
    peer = adapter()
    peer.prepare(robot, Question())
    assert peer.version
    if "ik" in peer.jobs:
        assert judge(robot, torch.from_numpy(peer.solve(T.numpy(), None)), T, tol_pos=1e-6, tol_rot=1e-6).solved.any()
    if "jacobian" in peer.jobs:
        assert np.allclose(peer.jacobian(q.numpy()), ik.jacobian(robot, q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("adapter", PEERS, ids=lambda adapter: adapter.name)
def test_adapters_refuse_mimic_joints(adapter: type[Peer], zoo_path):
    zoo = ik.load_robot(zoo_path, tip="hand")
    reason = adapter().available(zoo, next(iter(adapter.jobs)))
    assert reason is not None
    assert "mimic" in reason or "not installed" in reason


def test_peers_by_name():
    assert [peer.name for peer in peers(["none"], "ik")] == []
    assert "pinocchio" not in {peer.name for peer in peers(["all"], "ik")}
    assert "pinocchio" in {peer.name for peer in peers(["all"], "fk")}
    with pytest.raises(UnknownNameError, match="unknown peer 'robotictoolbox'; did you mean 'roboticstoolbox'"):
        peers(["robotictoolbox"], "ik")


@pytest.mark.parametrize("name", ["tight", "tracik", "curobo", "singular", "single"])
def test_every_protocol_solves_its_poses(panda: ik.Robot, name: str):
    (cell,) = bench_ik(panda, PROTOCOLS[name], TINY, [])
    assert cell.solver == "ikgrad"
    assert (cell.rows, cell.outside) == (12, 0)
    assert (cell.solved or 0) + (cell.late or 0) == 12
    assert cell.ratio.value == 1
    assert cell.mean.low <= cell.mean.value <= cell.mean.high
    assert (cell.late is not None) == (name == "tracik")
    assert cell.batch == (1 if PROTOCOLS[name].one_by_one else 12)


def test_no_unreachable_pose_is_solved(panda: ik.Robot):
    (cell,) = bench_ik(panda, PROTOCOLS["unreachable"], TINY, [])
    assert cell.solved == 0
    assert sum(cell.reasons.values()) == 12
    assert set(cell.reasons) <= {"unreachable", "no_convergence"}


def test_sizes_and_threads_make_cells(panda: ik.Robot):
    before = torch.get_num_threads()
    plan = Plan(rows=12, batches=(4, 0), threads=(1, 2), rounds=2, seconds=0.05)
    cells = bench_ik(panda, PROTOCOLS["tight"], plan, [])
    assert [(cell.batch, cell.threads) for cell in cells] == [(4, 1), (4, 2), (12, 1), (12, 2)]
    assert {cell.solved for cell in cells} == {12}
    assert torch.get_num_threads() == before


def test_paths_are_followed_together_and_one_by_one(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("ikgrad.bench.path.POINTS", 40)
    robot = ik.load_robot("ur5e")
    together, alone = bench_paths(robot, PROTOCOLS["path"], Plan(rows=2, rounds=1, seconds=0.05), [])
    assert (together.batch, alone.batch) == (2, 1)
    assert together.solved == alone.solved == together.rows == 80
    assert together.extra["largest_jump"] >= together.extra["largest_change_of_the_path"] / 2


def test_a_jump_is_avoidable_where_a_solution_is_near(panda: ik.Robot):
    q = ik.sample_configurations(panda, 6, seed=3)
    near = (q + 0.1).clamp(panda.q_min, panda.q_max)
    assert solvable_nearby(panda, ik.forward_kinematics(panda, near), q, 0.2).all()
    far = ik.forward_kinematics(panda, q)
    far[:, 0, 3] += 2.0
    assert not solvable_nearby(panda, far, q, 0.2).any()


@pytest.mark.parametrize(("command", "jobs"), [("fk", ["fk", "fk_backward"]), ("jacobian", ["jacobian"])])
def test_kinematics_are_timed(panda: ik.Robot, command: str, jobs: list[str]):
    cells = bench_kinematics(panda, command, Plan(rows=64, rounds=2, seconds=0.05), peers(["pytorch-kinematics"], "fk"))
    assert [cell.job for cell in cells if cell.solver == "ikgrad"] == jobs
    assert all(cell.mean.value > 0 for cell in cells if cell.missing is None)


def test_a_peer_with_another_result_is_not_timed(panda: ik.Robot):
    class Wrong(Ikgrad):
        name = "wrong"

        def fk(self, q: np.ndarray) -> np.ndarray:
            return super().fk(q) * 1.001

    cells = bench_kinematics(panda, "fk", Plan(rows=8, rounds=1, seconds=0.05), [Wrong()])
    (cell,) = [cell for cell in cells if cell.solver == "wrong" and cell.job == "fk"]
    assert "differs from ours" in cell.missing


KEYS = {
    "robot",
    "solver",
    "batch",
    "threads",
    "job",
    "version",
    "rows",
    "calls",
    "solved",
    "success",
    "outside",
    "late",
}
KEYS |= {"median", "percentile_95", "mean", "ratio", "errors", "reasons", "extra", "missing"}


def test_the_command_prints_json_and_writes_it(capsys: pytest.CaptureFixture[str], tmp_path):
    path = tmp_path / "bench.json"
    arguments = ["bench", "ik", "--robot", "panda", "--rows", "8", "--seconds", "0.05", "--rounds", "2"]
    peer = ["--peers", "pytorch-kinematics", "eaik"]
    assert main([*arguments, *peer, "--json", "--out", str(path)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads(path.read_text())
    assert report["schema"] == 1
    assert {"date", "cpu", "cores", "python", "versions", "load_average"} <= set(report["environment"])
    assert {"ikgrad", "torch", "numba", "pytorch-kinematics"} <= set(report["environment"]["versions"])
    assert report["settings"]["plan"]["rows"] == 8
    ours, theirs, eaik = report["cells"]
    assert set(ours) == set(theirs) == KEYS
    assert ours["success"] == 1
    assert set(theirs["ratio"]) == {"value", "low", "high"}
    assert "not installed" in eaik["missing"] or "six" in eaik["missing"]


@pytest.mark.parametrize("protocol", ["tight", "curobo", "unreachable"])
def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str], protocol: str):
    arguments = ["bench", "ik", "--rows", "8", "--seconds", "0.05", "--rounds", "2", "--protocol", protocol]
    assert main([*arguments, "--peers", "none"]) == 0
    out = capsys.readouterr().out
    assert f"ikgrad bench ik: {PROTOCOLS[protocol].says}" in out
    assert "cores" in out
    assert ("100 %" in out) == (protocol != "unreachable")
    assert ("mm 50/95 %" in out) == (protocol == "curobo")


def test_the_kinematics_commands_print_tables(capsys: pytest.CaptureFixture[str]):
    assert main(["bench", "fk", "--rows", "64", "--seconds", "0.05", "--rounds", "2", "--peers", "none"]) == 0
    assert "fk_backward" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ik", "--protocol", "tigt"], "unknown protocol 'tigt'; did you mean 'tight'"),
        (["ik", "--robot", "pandda"], "unknown robot 'pandda'; did you mean 'panda'"),
        (["fk", "--peers", "pinochio"], "unknown peer 'pinochio'; did you mean 'pinocchio'"),
        (["ik", "--rows", "10", "--batch", "11"], "a batch of 11 is more than the 10 rows"),
        (["ik", "--protocol", "single", "--batch", "4"], "has batch sizes of its own"),
        (["ik", "--rows", "0"], "expected a whole number, at least 1, got '0'"),
        (["ik", "--seconds", "-1"], "expected a number above 0"),
        (["ik", "--rws", "3"], "unknown option '--rws'; did you mean '--rows'"),
        (["fk", "--protocol", "tight"], "unknown option '--protocol'"),
        (["ik", "--out", "bench.txt"], "unknown kind of file '.txt'"),
        (["ik", "--protocol", "singular", "--robot", "arm4"], "its Jacobian is singular everywhere"),
        ([], "JOB"),
    ],
)
def test_mistakes_are_one_line(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str):
    assert main(["bench", *arguments]) == 2
    errors = capsys.readouterr().err.strip()
    assert message in errors
    assert len(errors.splitlines()) == 1


def test_a_request_is_checked_before_any_work():
    with pytest.raises(ConfigError, match="more than the 100000 rows"):
        Request("fk", ("panda",), plan=Plan(rows=0, batches=(200_000,))).resolve()
    assert Request("ik", ("panda",)).resolve().plan.rows == PROTOCOLS["tight"].rows


def test_the_memory_of_a_process_is_its_own_and_not_that_of_its_parent():
    ours = np.ones(50_000_000)  # 400 MB
    assert run_python(["-c", "pass"]).peak < 100
    assert 200 < run_python(["-c", "b'1' * 200_000_000"]).peak < 300
    assert ours[-1] == 1


def test_a_process_that_fails_says_why():
    with pytest.raises(ConfigError, match="process of the benchmark failed: ValueError: no such thing"):
        run_python(["-c", "raise ValueError('no such thing')"])


@pytest.mark.slow
def test_a_file_goes_through_the_command_in_bounded_memory(capsys: pytest.CaptureFixture[str]):
    assert main(["bench", "ik", "--protocol", "stream", "--rows", "100000", "--json"]) == 0
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert [cell["solver"] for cell in cells] == ["ikgrad, NPY", "ikgrad, Parquet"]
    for cell in cells:
        assert cell["solved"] == 100_000
        assert cell["extra"]["peak_memory_mb"] < 700


@pytest.mark.slow
def test_a_fresh_process_is_timed(capsys: pytest.CaptureFixture[str]):
    assert main(["bench", "ik", "--protocol", "cold", "--rows", "1", "--json"]) == 0
    cached, compiling = json.loads(capsys.readouterr().out)["cells"]
    assert cached["median"] < compiling["median"]
    assert compiling["extra"]["says_so"] == 1
