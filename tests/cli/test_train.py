"""``ikgrad train``: what it prints, how options change a file, one line for every mistake, and life after kill -9."""

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
from support import mistake

import ikgrad as ik
from ikgrad.cli.main import main

CONFIGS = Path(__file__).parents[2] / "configs"
BOX = "{scheme: joint_box, count: 120, half_width: 0.3}"
QUICK = ["train", "--model", "classic", "--robot", "denso_vp6242", "--hidden", "[5]", "--data", BOX, "--epochs", "4"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """No file lands in the repository, and no progress lines where a busy machine takes its time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)


def test_the_command_of_the_page(capsys: pytest.CaptureFixture[str]):
    argv = [
        "train",
        "--config",
        str(CONFIGS / "denso_feedback.yaml"),
        "--hidden",
        "[20]",
        "--seed",
        "3",
        "--epochs",
        "9",
    ]
    assert main(argv) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "ikgrad train: denso_vp6242, feedback, 12-20-6, levenberg_marquardt" in out
    assert "written to runs/denso_feedback_seed3" in out
    assert ik.load_inverter("runs/denso_feedback_seed3/model").feedback


def test_json_is_one_document(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--members", "2", "--out", "x", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["hidden"] == [5]
    assert [member["seed"] for member in document["members"]] == [0, 1]
    assert document["members"][1]["test"]["rows"] == 18


def test_a_built_in_name_and_keys_of_its_data(capsys: pytest.CaptureFixture[str]):
    assert main(["train", "--config", "denso_traditional", "--data", "{count: 100}", "--epochs", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["data"]["scheme"] == "smooth_path"
    assert document["members"][0]["test"]["rows"] == 15


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--hiden", "[3]"], "unknown option '--hiden'; did you mean '--hidden'?"),
        (
            ["--config", "bad.yaml"],
            "bad.yaml: unknown key 'hiden'; did you mean 'hidden'? (known: robot, base, tip, model,",
        ),
        (["--config", "denso_fedback"], "unknown configuration 'denso_fedback'; did you mean 'denso_feedback'?"),
        (["--config", "none.yaml"], "none.yaml: cannot read the configuration: No such file or directory"),
        (["--hidden", "20"], "options: key 'hidden' must be of type tuple[int, ...], got 20"),
        (["--hidden", "[20"], "--hidden: not a YAML value"),
        (["--feedback", "perhaps"], "key 'feedback' must be of type bool, got 'perhaps'"),
        (["--robot", "dneso_vp6242"], "unknown robot 'dneso_vp6242'; did you mean 'denso_vp6242'?"),
        (["--optimizer", "adamw"], "unknown optimizer 'adamw'; did you mean 'AdamW'?"),
        (["--data", "{scheme: cub}"], "unknown sampling scheme 'cub'; did you mean 'cube'?"),
        (["--data", "{cuont: 3}"], "options: key 'data' must name a 'scheme', or change keys of one"),
        (["--data", "{scheme: cube, cuont: 3}"], "data: scheme 'cube': unknown key 'cuont'; did you mean 'count'?"),
        (["--data", "{scheme: cube, count: 0}"], "count must be at least 1, got 0; an empty data set teaches nothing"),
        (["--data", "ur5e.safetensors"], "ur5e.safetensors: data of robot 'ur5e' with fingerprint"),
        (["--data", "torn.safetensors"], "torn.safetensors: is not a data file, or is damaged"),
        (["--hidden", "[1000000]"], "but there are"),
        (["--resume", "--force"], "--resume goes on with a run and --force replaces it; give one of the two"),
        (["--out", "bad.yaml"], "bad.yaml: is a file, not a folder"),
        (["--out", "."], "exists and holds no training run; choose another name"),
        (["--checkpoint-seconds", "0"], "--checkpoint-seconds: expected a number above 0"),
        (["--tensorboard", "true"], "tensorboard: events need tensorboard; pip install 'ikgrad[train]'"),
    ],
)
def test_mistakes_get_one_line_and_write_nothing(options, message, tmp_path: Path, monkeypatch, capsys):
    (tmp_path / "bad.yaml").write_text("model: classic\nrobot: panda\nhiden: [3]\n")
    ik.data.generate(ik.load_robot("ur5e"), ik.data.JointBox(count=20)).save("ur5e.safetensors")
    (tmp_path / "torn.safetensors").write_bytes((tmp_path / "ur5e.safetensors").read_bytes()[:-9])
    if "--tensorboard" in options:
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    before = sorted(tmp_path.iterdir())
    quick = [word for word in QUICK if word not in ("--data", BOX)] if options[0] == "--data" else QUICK
    assert message in mistake(capsys, *quick, *options)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("model", ["classic", "unrolled"])
def test_a_robot_must_be_given(model: str, capsys: pytest.CaptureFixture[str]):
    line = mistake(capsys, "train", "--model", model)
    assert "robot must be the name of a built-in robot or the path of a URDF file, got nothing" in line


def test_a_run_is_not_replaced_without_force(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--out", "x"]) == 0
    capsys.readouterr()
    assert "x: holds a run already; it is replaced with --force only" in mistake(capsys, *QUICK, "--out", "x")
    assert main([*QUICK, "--out", "x", "--seed", "2", "--force"]) == 0
    assert json.loads(Path("x/run.json").read_text())["seed"] == 2


def test_a_loss_that_is_not_finite_is_one_line(capsys: pytest.CaptureFixture[str]):
    wild = [*QUICK, "--optimizer", "SGD", "--lr", "1e4", "--activation", "relu", "--epochs", "50", "--out", "x"]
    line = mistake(capsys, *wild)
    assert re.search(r"the loss is not finite after epoch \d+, step \d+;", line)
    assert "the weights are those of epoch" in line
    assert "kept in x/model" in line


# ---------------------------------------------------------------- kills

SLOW = {
    "adam": ["--optimizer", "Adam", "--lr", "0.003", "--batch-size", "20", "--members", "2", "--epochs", "60"],
    "levenberg_marquardt": ["--hidden", "[16]", "--epochs", "60"],
}


RUN = """
import sys, time
from ikgrad.cli.main import main
from ikgrad.training.run import Run
look = Run._look
Run._look = lambda *arguments: (look(*arguments), time.sleep(0.1))  # time to be killed in
sys.exit(main(sys.argv[1:]))
"""


def start(*argv: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, *QUICK, *argv, "--out", "cut", "--checkpoint-seconds", "0.05"]
    environment = {**os.environ, "PYTHONPATH": str(Path(ik.__file__).parents[1])}
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


def weights(folder: str) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in sorted(Path(folder).rglob("*.safetensors"))}


@pytest.mark.parametrize("name", SLOW)
def test_a_run_killed_with_kill_9_goes_on_to_the_same_weights(name: str, capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, *SLOW[name], "--out", "whole"]) == 0
    status, _ = stop(start(*SLOW[name]), signal.SIGKILL)
    assert status == -signal.SIGKILL
    capsys.readouterr()
    again = [*QUICK, *SLOW[name], "--out", "cut"]
    assert "cut: holds an unfinished run; --resume goes on with it, --force starts anew" in mistake(capsys, *again)
    other = mistake(capsys, *again, "--seed", "7", "--resume")
    assert "cut: cannot go on with other settings: seed was 0, is 7; content of the data was" in other
    assert main([*again, "--resume"]) == 0
    assert weights("cut") == weights("whole") != {}
    assert Path("cut/history.csv").read_text() == Path("whole/history.csv").read_text()


def test_ctrl_c_ends_with_130_and_says_how_to_go_on(capsys: pytest.CaptureFixture[str]):
    status, err = stop(start(*SLOW["adam"]), signal.SIGINT)
    assert status == 130
    assert "of 60 epochs; the same command with --resume goes on (checkpoint in cut/checkpoint)" in err
    assert "Traceback" not in err
    assert main(["train", "--resume", "--out", "cut"]) == 0  # the settings are those of the folder
    assert "written to cut" in capsys.readouterr().out
    assert main(["train", "--resume", "--out", "cut"]) == 0
    assert not Path("cut/checkpoint").exists()


def test_damaged_files_of_a_run_are_refused(capsys: pytest.CaptureFixture[str]):
    stop(start(*SLOW["adam"]), signal.SIGKILL)
    checkpoint = Path("cut/checkpoint")
    whole = checkpoint.read_bytes()
    for content in (whole[:-100], whole[:2000] + b"x" + whole[2001:]):
        checkpoint.write_bytes(content)
        assert "checkpoint is truncated or was changed" in mistake(capsys, "train", "--resume", "--out", "cut")
        assert checkpoint.read_bytes() == content
    checkpoint.write_bytes(whole)
    assert main(["train", "--resume", "--out", "cut"]) == 0
    capsys.readouterr()
    model = Path("cut/model-1/model.safetensors")
    model.write_bytes(model.read_bytes()[:-1] + b"x")
    assert "the weights are truncated or were changed" in mistake(capsys, "train", "--resume", "--out", "cut")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes everywhere")
def test_a_read_only_place_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    place = tmp_path / "locked"
    place.mkdir(mode=0o555)
    assert "is not writable: Permission denied" in mistake(capsys, *QUICK, "--out", "locked/x")
