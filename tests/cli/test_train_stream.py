"""``ikgrad train`` on a stream: any robot, what it prints, one line for every mistake, and life after kill -9."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support import ZOO, mistake

import ikgrad as ik
from ikgrad.cli.main import main
from ikgrad.cli.train_stream import LiveCurve
from ikgrad.config import StreamConfig
from ikgrad.training.endless import Check
from ikgrad.training.train import StreamProgress

SMALL = ["--width", "16", "--batch-size", "64", "--checks", "3", "--test-rows", "100"]
QUICK = ["train", "--robot", "ur5e", *SMALL]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """No file lands in the repository, and no progress lines where a busy machine takes its time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)


def test_one_command_for_a_urdf_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "zoo.urdf").write_text(ZOO)
    assert main(["train", "--robot", "zoo.urdf", "--tip", "hand", "--minutes", "0.005", *SMALL]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "unrolled (rounds 4, damping 0.1, width 16, depth 2, activation gelu)" in out
    assert ", task local, 0.5 rad, 100 poses" in out
    assert ", task global, 100 poses" in out
    assert out.count("| plain, 4 steps |") == 2
    assert "written to runs/zoo_seed0" in out
    assert ik.load_inverter("runs/zoo_seed0/model", robot=ik.load_robot("zoo.urdf", tip="hand")).family == "unrolled"
    records = json.loads(Path("runs/zoo_seed0/evaluation.json").read_text())
    assert [record["count"] for record in records] == [100, 100]


def test_json_is_one_document_with_every_task(capsys: pytest.CaptureFixture[str]):
    wanted = ["--model", "increment", "--steps", "4", "--spread", "0.1", "--members", "2", "--json"]
    assert main([*QUICK, *wanted, "--out", "x"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["model"] == "increment"
    assert [member["seed"] for member in document["members"]] == [0, 1]
    assert [task["task"] for task in document["evaluation"]] == ["local, 0.5 rad", "local, 0.1 rad", "global"]
    assert document["evaluation"] == json.loads(Path("x/evaluation.json").read_text())


def test_members_are_listed(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--steps", "2", "--members", "2", "--config", "inverter", "--out", "x"]) == 0
    out = capsys.readouterr().out
    assert "Below: the member with the smallest loss on these rows." in out
    assert ik.load_inverter("x/model-1").robot.name == "ur5e"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--minuts", "3"], "unknown option '--minuts'; did you mean '--minutes'?"),
        (["--hidden", "[3]"], "key 'hidden' belongs to model classic, but model is unrolled"),
        (["--model", "clasic"], "key 'model' must be unrolled, increment or classic, got 'clasic'; did you mean"),
        (["--config", "denso_feedback"], "key 'width' belongs to the models unrolled and increment, but model is"),
        (["--minutes", "soon"], "options: key 'minutes' must be of type float, got 'soon'"),
        (["--lr", ".nan"], "lr must be positive and finite, got nan"),
        (["--width", "10000000"], "try fewer hidden units"),
        (["--robot", "pandda"], "unknown robot 'pandda'; did you mean 'panda'?"),
        (["--robot", "none.urdf"], "none.urdf"),
        (["--robot", "zoo.urdf"], "choose one with tip=... (--tip)"),
        (["--device", "cuda"], "device 'cuda': torch sees no CUDA device here; take cpu"),
        (["--resume", "--force"], "--resume goes on with a run and --force replaces it; give one of the two"),
    ],
)
def test_mistakes_get_one_line_and_write_nothing(options, message, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    (tmp_path / "zoo.urdf").write_text(ZOO)
    assert message in mistake(capsys, *QUICK, *options)
    assert [path.name for path in tmp_path.iterdir()] == ["zoo.urdf"]


def test_a_run_is_not_replaced_without_force(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--steps", "2", "--out", "x"]) == 0
    capsys.readouterr()
    again = [*QUICK, "--steps", "3", "--out", "x"]
    assert "x: holds a run already; it is replaced with --force only" in mistake(capsys, *again)
    assert main([*again, "--force"]) == 0
    assert json.loads(Path("x/run.json").read_text())["members"][0]["steps"] == 3


def test_the_live_curve_says_how_fast_how_long_and_how_good():
    curve = LiveCurve(StreamConfig(robot="panda", members=2))
    assert curve.state() == "starting"
    assert curve.where == "before the first step"
    check = Check(0, 0.0, 1.0, (2.345, 9.0), (0.4567, 2.0))
    curve.show(StreamProgress(0.5, 1000, 30.0, 30.0, 0, check))
    assert curve.state() == "50 %, 1,000 steps, starting"  # a resumed run: no rate yet
    curve.show(StreamProgress(0.75, 1600, 45.0, 15.0, 1, check))
    assert curve.state() == "75 %, 1,600 steps, member 2 of 2, 40 steps/s, 15 s left; median 2.3 mm, 0.46 deg"
    assert curve.where == "after 1,600 steps"
    assert curve.done == 750


# ---------------------------------------------------------------- kills

RUN = """
import sys, time
from ikgrad.cli.main import main
from ikgrad.training.stream_run import StreamRun
look = StreamRun._look
StreamRun._look = lambda *arguments: (look(*arguments), time.sleep(0.1))  # time to be killed in
sys.exit(main(sys.argv[1:]))
"""
SLOW = [*QUICK, "--model", "increment", "--steps", "40", "--checks", "10"]


def start(*argv: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, *argv, "--out", "cut", "--checkpoint-seconds", "0.05"]
    environment = {**os.environ, "PYTHONPATH": str(Path(ik.__file__).parents[1]), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment)


def stop(process: subprocess.Popen[str], how: signal.Signals) -> tuple[int, str]:
    """Stop it in the middle: after a checkpoint, long before the end."""
    end = time.monotonic() + 100
    while not Path("cut/checkpoint").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    process.send_signal(how)
    _, err = process.communicate(timeout=100)
    assert json.loads(Path("cut/run.json").read_text())["state"] == "running"
    return process.returncode, err


def test_a_run_killed_with_kill_9_goes_on_to_the_same_weights(capsys: pytest.CaptureFixture[str]):
    assert main([*SLOW, "--out", "whole"]) == 0
    status, _ = stop(start(*SLOW), signal.SIGKILL)
    assert status == -signal.SIGKILL
    capsys.readouterr()
    assert "cut: holds an unfinished run; --resume goes on with it" in mistake(capsys, *SLOW, "--out", "cut")
    other = mistake(capsys, *SLOW, "--out", "cut", "--seed", "7", "--resume")
    assert "cut: cannot go on with other settings: seed was 0, is 7; --force starts anew" in other
    assert main([*SLOW, "--out", "cut", "--resume"]) == 0
    weights = [Path(folder, "model", "model.safetensors").read_bytes() for folder in ("whole", "cut")]
    assert weights[0] == weights[1]
    assert not Path("cut/checkpoint").exists()


def test_ctrl_c_ends_with_130_and_says_how_to_go_on(capsys: pytest.CaptureFixture[str]):
    status, err = stop(start(*SLOW), signal.SIGINT)
    assert status == 130
    assert re.search(r"interrupted after \d+ steps; the same command with --resume goes on \(checkpoint in cut/", err)
    assert "Traceback" not in err
    assert main(["train", "--resume", "--out", "cut"]) == 0  # the settings are those of the folder
    assert "written to cut" in capsys.readouterr().out
