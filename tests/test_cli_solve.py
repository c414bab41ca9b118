"""``ikgrad solve``: every row answered, bad rows reported, runs stopped and gone on with."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.cli import solve_job
from ikgrad.cli.main import main
from ikgrad.files import pose_writer

ROBOT = "puma560"


@pytest.fixture(scope="module")
def robot():
    return ik.load_robot(ROBOT)


@pytest.fixture(scope="module")
def poses(robot):
    return ik.forward_kinematics(robot, ik.sample_configurations(robot, 40, seed=0))


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """No progress lines where a busy machine takes its time."""
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)


@pytest.fixture
def place(tmp_path, monkeypatch, poses):
    """A folder with poses.npy and poses.csv, which is the current one."""
    monkeypatch.chdir(tmp_path)
    for name in ("poses.npy", "poses.csv"):
        with pose_writer(name) as writer:
            writer.append(poses)
    return tmp_path


def solve(*argv: str) -> int:
    return main(["solve", "--robot", ROBOT, *argv])


def summary(capsys, *argv: str) -> dict:
    assert solve(*argv, "--json") == 0
    return json.loads(capsys.readouterr().out)


def mistake(capsys, *argv: str) -> str:
    assert solve(*argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def rows(path: str) -> list[dict[str, str]]:
    with open(path) as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------- answers


def test_joints_reach_the_poses(capsys, place, robot, poses):
    assert solve("poses.csv", "-o", "joints.csv") == 0
    out = capsys.readouterr().out
    assert "solved                       40 of 40 (100.00 %)" in out
    assert "poses/s" in out
    answer = rows("joints.csv")
    assert list(answer[0]) == [
        *robot.joint_names,
        "position_error_m",
        "rotation_error_rad",
        "success",
        "reason",
        "steps",
    ]
    q = torch.tensor([[float(row[name]) for name in robot.joint_names] for row in answer], dtype=torch.float64)
    error = ik.pose_error(ik.forward_kinematics(robot, q), poses)
    assert error[:, :3].norm(dim=1).max() < 1.01e-6
    assert error[:, 3:].norm(dim=1).max() < 1.01e-6
    assert {row["reason"] for row in answer} == {"converged"}
    assert {row["success"] for row in answer} == {"true"}


def test_the_answers_are_those_of_solve_ik_in_every_kind_of_file(capsys, place, robot, poses):
    expected = ik.solve_ik(robot, poses)
    for name in ("a.csv", "b.npz", "c.parquet"):
        document = summary(capsys, "poses.npy", "-o", name, "--chunk", "7")
        assert document["solved"] == 40
        assert document["worst_position_error_m"] == expected.position_error.max().item()
    with np.load("b.npz") as archive:
        assert np.array_equal(archive["q"], expected.q)
        assert archive["reason"].tolist() == expected.reason.tolist()
    import pyarrow.parquet

    table = pyarrow.parquet.read_table("c.parquet")
    assert table.column_names == list(rows("a.csv")[0])
    for k, name in enumerate(robot.joint_names):
        assert table[name].to_pylist() == expected.q[:, k].tolist()
        assert [float(row[name]) for row in rows("a.csv")] == expected.q[:, k].tolist()


def test_several_solutions_are_numbered(capsys, place, robot, poses):
    document = summary(capsys, "poses.npy", "-o", "q.csv", "--solutions", "3", "--chunk", "16")
    answer = rows("q.csv")
    assert [(int(row["row"]), int(row["solution"])) for row in answer] == [(k // 3, k % 3) for k in range(120)]
    assert document["poses"] == 40
    assert document["solutions_found"] == sum(row["success"] == "true" for row in answer) > 60


@pytest.mark.parametrize("solver", ["apps", "newton"])
def test_other_solvers(capsys, place, solver):
    document = summary(capsys, "poses.npy", "-o", "q.npz", "--solver", solver, "--no-limits", "--tol-pos", "1e-3")
    assert document["poses"] == 40
    assert document["solved"] + sum(document["failed"].values()) == 40


def test_starts_come_from_a_file(capsys, place, robot, poses):
    q0 = ik.sample_configurations(robot, 40, seed=0)
    np.save("q0.npy", q0)
    summary(capsys, "poses.npy", "-o", "q.npz", "--q0", "q0.npy", "--chunk", "9")
    np.save("one.npy", q0[:1])
    summary(capsys, "poses.npy", "-o", "one.npz", "--q0", "one.npy", "--chunk", "9")
    with np.load("q.npz") as each, np.load("one.npz") as one:
        assert np.abs(each["q"] - q0.numpy()).max() < 1e-9
        assert np.array_equal(one["q"], ik.solve_ik(robot, poses, q0=q0[0]).q)


def test_starts_must_fit_the_poses(capsys, place):
    np.save("q0.npy", np.zeros((7, 6)))
    line = mistake(capsys, "poses.npy", "-o", "q.npz", "--q0", "q0.npy")
    assert "q0.npy: has 7 rows, expected 40, one for each pose (or one for all)" in line


def test_mask_and_tolerances_reach_the_solver(capsys, place):
    document = summary(capsys, "poses.npy", "-o", "q.npz", "--mask", "1,1,1,0,0,0", "--tol-pos", "1e-9")
    assert document["solved"] == 40
    assert document["worst_position_error_m"] <= 1e-9


def test_plot_is_drawn(capsys, place):
    assert solve("poses.npy", "-o", "q.csv", "--plot", "report.png") == 0
    assert Path("report.png").read_bytes()[:4] == b"\x89PNG"
    capsys.readouterr()
    assert "exists already" in mistake(capsys, "poses.npy", "-o", "other.csv", "--plot", "report.png")
    assert not Path("other.csv").exists()


# ---------------------------------------------------------------- bad rows, bad files


def bad_poses(poses):
    bad = poses.clone()
    bad[3, 0, 3] = torch.nan
    bad[5, 1, 1] = torch.inf
    bad[7, :3, :3] *= 1.01
    bad[9] = bad[9].mT.clone()
    bad[11, 0, 3] += 50
    return bad


def test_bad_rows_are_reported_and_the_others_solved(capsys, place, poses):
    np.save("bad.npy", bad_poses(poses))
    document = summary(capsys, "bad.npy", "-o", "q.csv")
    assert document["solved"] == 35
    assert document["failed"] == {"invalid_target": 4, "unreachable": 1}
    assert document["invalid"]["not_finite"] == 2
    assert document["invalid"]["no_rigid_transform"] == 2
    assert document["invalid"]["worst_deviation"] == pytest.approx(1.01**2 - 1)
    assert [k for k, row in enumerate(rows("q.csv")) if row["reason"] == "invalid_target"] == [3, 5, 7, 9]
    assert solve("bad.npy", "-o", "q.npz") == 0
    out = capsys.readouterr().out
    assert "2 poses are not finite or have a number missing." in out
    assert "1 pose is no rotation: max |R^T R - I| up to 0.0201; --repair projects them." in out
    assert "1 pose is mirrored, or without 0 0 0 1 as last row (transposed?)." in out


def test_repair_projects(capsys, place, poses):
    np.save("bad.npy", bad_poses(poses))
    document = summary(capsys, "bad.npy", "-o", "q.csv", "--repair")
    assert document["solved"] == 36
    assert document["invalid"]["repaired"] == 1
    assert rows("q.csv")[7]["reason"] == "converged"


def test_an_error_late_in_the_file_leaves_nothing(capsys, place):
    lines = Path("poses.csv").read_text().splitlines()
    lines[30] = lines[30].replace(",", ",x", 1)
    Path("late.csv").write_text("\n".join(lines))
    before = sorted(place.iterdir())
    line = mistake(capsys, "late.csv", "-o", "q.csv", "--chunk", "8")
    assert "late.csv, line 31, column 'y_m': expected a number, got 'x" in line
    assert sorted(place.iterdir()) == before


def test_outputs_are_refused_before_the_work(capsys, place, monkeypatch):
    monkeypatch.setattr(solve_job, "solve_ik", None)  # would fail if it were called
    Path("old.csv").write_text("precious")
    assert "exists already" in mistake(capsys, "poses.csv", "-o", "old.csv")
    assert "is the input" in mistake(capsys, "poses.csv", "-o", "poses.csv", "--force")
    assert "name the same file" not in mistake(capsys, "poses.csv", "-o", "none/q.csv", "--plot", "q.png")
    assert Path("old.csv").read_text() == "precious"


# ---------------------------------------------------------------- stopped, and gone on with


def interrupted_after(calls: int, monkeypatch, error: BaseException) -> None:
    real, count = ik.solve_ik, iter(range(calls))

    def solve_ik(*args, **settings):
        if next(count, None) is None:
            raise error
        return real(*args, **settings)

    monkeypatch.setattr(solve_job, "solve_ik", solve_ik)


@pytest.mark.parametrize("kind", ["csv", "npz", "parquet"])
def test_ctrl_c_keeps_what_is_finished_and_resume_gives_the_same_bytes(capsys, place, monkeypatch, kind):
    summary(capsys, "poses.csv", "-o", f"whole.{kind}", "--chunk", "8")
    command = ["poses.csv", "-o", f"q.{kind}", "--chunk", "8"]
    interrupted_after(3, monkeypatch, KeyboardInterrupt())
    assert solve(*command) == 130
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        f"ikgrad: interrupted; finished parts are kept in q.{kind}.partial, "
        "the same command with --resume goes on from there\n"
    )
    assert not Path(f"q.{kind}").exists()
    assert len(list(Path(f"q.{kind}.partial").glob("part-*"))) == 3
    assert "--resume goes on with it, --force starts anew" in mistake(capsys, *command)

    interrupted_after(2, monkeypatch, AssertionError("finished parts must not be solved again"))
    assert summary(capsys, *command, "--resume")["solved"] == 40
    assert Path(f"q.{kind}").read_bytes() == Path(f"whole.{kind}").read_bytes()
    assert not Path(f"q.{kind}.partial").exists()


def test_ctrl_c_before_anything_is_finished_leaves_nothing(capsys, place, monkeypatch):
    before = sorted(place.iterdir())
    interrupted_after(0, monkeypatch, KeyboardInterrupt())
    assert solve("poses.csv", "-o", "q.csv") == 130
    assert capsys.readouterr().err == "ikgrad: interrupted; nothing was written\n"
    assert sorted(place.iterdir()) == before


def test_ctrl_c_while_the_output_is_put_together_keeps_the_parts(capsys, place, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("ikgrad.files.writers.CsvWriter.append", interrupt)
        assert solve("poses.csv", "-o", "q.csv", "--chunk", "8") == 130
    assert "--resume" in capsys.readouterr().err
    assert not Path("q.csv").exists()
    interrupted_after(0, monkeypatch, AssertionError("nothing is left to solve"))
    assert summary(capsys, "poses.csv", "-o", "q.csv", "--chunk", "8", "--resume")["poses"] == 40


def test_a_full_disk_keeps_what_is_finished(capsys, place, monkeypatch):
    interrupted_after(2, monkeypatch, OSError(28, "No space left on device"))
    line = mistake(capsys, "poses.csv", "-o", "q.csv", "--chunk", "8")
    assert "No space left on device; finished parts are kept in q.csv.partial" in line


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--seed", "1"], "seed was 0, is 1"),
        (["--tol-pos", "1e-5"], "tol_pos was 1e-06, is 1e-05"),
        (["--mask", "1,1,1,0,0,0"], "mask was None, is (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)"),
        (["--repair"], "repair was False, is True"),
        (["--tip", "link_4"], "robot fingerprint was"),
        (["--chunk", "9"], "rows at a time was 8, is 9"),
    ],
)
def test_resume_refuses_other_settings(capsys, place, monkeypatch, change, message):
    command = ["poses.csv", "-o", "q.csv", "--chunk", "8"]
    interrupted_after(2, monkeypatch, KeyboardInterrupt())
    assert solve(*command) == 130
    capsys.readouterr()
    assert message in mistake(capsys, *command, *change, "--resume")
    assert len(list(Path("q.csv.partial").glob("part-*"))) == 2


def test_resume_refuses_other_poses(capsys, place, monkeypatch):
    command = ["poses.csv", "-o", "q.csv", "--chunk", "8"]
    interrupted_after(2, monkeypatch, KeyboardInterrupt())
    assert solve(*command) == 130
    capsys.readouterr()
    Path("poses.csv").write_text(Path("poses.csv").read_text().replace("0", "1", 1))
    assert "content of the poses was" in mistake(capsys, *command, "--resume")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_process_can_be_gone_on_with(capsys, place, how):
    command = ["poses.csv", "-o", "q.csv", "--chunk", "2"]
    summary(capsys, "poses.csv", "-o", "whole.csv", "--chunk", "2")
    code = (  # slow enough to be hit in the middle, whatever the machine
        "import signal, sys, time\nfrom ikgrad.cli import solve_job\nfrom ikgrad.cli.main import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background may ignore it\n"
        "real = solve_job.solve_ik\n"
        "def slow(*a, **k):\n    time.sleep(0.3)\n    return real(*a, **k)\n"
        "solve_job.solve_ik = slow\nsys.exit(main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, "solve", "--robot", ROBOT, *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    deadline = time.monotonic() + 120
    while len(list(Path("q.csv.partial").glob("part-*.npz"))) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(how)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (130 if how == signal.SIGINT else -how)
    assert b"Traceback" not in err
    assert not Path("q.csv").exists()
    assert summary(capsys, *command, "--resume")["solved"] == 40
    assert Path("q.csv").read_bytes() == Path("whole.csv").read_bytes()
    assert not Path("q.csv.partial").exists()
