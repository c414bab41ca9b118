"""``ikgrad reproduce puma``: what it prints, writes and refuses, and how it goes on after a kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ikgrad.cli.main import main

QUICK = ["reproduce", "puma", "--epochs", "60", "--seeds", "2"]
NAMES = {"puma_learning.png", "puma_errors.png", "puma_path.png", "puma.json"}


def test_json_is_one_document(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["seeds"] == 2
    assert [case["rule"]["name"] for case in document["cases"][:5]] == ["OBP", "OBPR", "BBP", "DBD", "QP"]


def test_tables_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main([*QUICK, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for part in ("Table 1", "Table 2", "Table 6", "Table 8", "Ranking", "Misprints", "py 686.19->686.99"):
        assert part in text
    assert {path.name for path in out.iterdir()} == NAMES
    assert main([*QUICK, "--out", str(out)]) == 2
    assert "exists already; it is overwritten with --force only" in capsys.readouterr().err
    assert main([*QUICK, "--out", str(out), "--force"]) == 0
    assert {path.name for path in out.iterdir()} == NAMES


def test_one_rule_by_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "mine.yaml"
    path.write_text("name: wide\nrule: quickprop\norder: batch\nhidden: [20]\n")
    assert main([*QUICK, "--config", str(path)]) == 0
    text = capsys.readouterr().out
    assert "wide" in text
    assert "3-20-6 logistic" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--full"], "--full means --epochs 1000000; give one of the two"),
        (["--resume"], "--resume needs --out DIR"),
        (["--seeds", "0"], "at least 1"),
        (["--config", "{tmp}/missing.yaml"], "cannot read the configuration"),
        (["--config", "{tmp}/rule.yaml"], "rule.yaml: unknown key 'momentun'; did you mean 'momentum'?"),
        (["--config", "{tmp}/qp.yaml"], "qp.yaml: momentum does not exist in quickprop, got 0.5"),
        (["--config", "{tmp}/twice.yaml", "--config", "{tmp}/twice.yaml"], "name must differ between the rules"),
        (["--out", "{tmp}/no/where"], "does not exist; create it first"),
    ],
)
def test_mistakes_get_one_line(options, message, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "rule.yaml").write_text("momentun: 0.5\n")
    (tmp_path / "qp.yaml").write_text("rule: quickprop\nmomentum: 0.5\n")
    (tmp_path / "twice.yaml").write_text("name: twice\n")
    assert main([*QUICK, *(option.format(tmp=tmp_path) for option in options)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.strip().splitlines()) == 1


RUN = """
import sys
from ikgrad.cli.main import main
from ikgrad.papers.puma import training
training.CHECKPOINT_EVERY = 0.3
sys.exit(main(sys.argv[1:]))
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, "reproduce", "puma", "--seeds", "2", *arguments]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, err = process.communicate(timeout=200)
    return process.returncode, err


def wait_for(folder: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 100
    while not list(folder.glob("*.ckpt")):
        assert process.poll() is None, finish(process)
        assert time.monotonic() < end
        time.sleep(0.02)


def numbers(folder: Path) -> list[list[float]]:
    return [case["rms_deg"] for case in json.loads((folder / "puma.json").read_text())["cases"]]


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_was_cut_off_goes_on_to_the_same_numbers(stop: signal.Signals, tmp_path: Path):
    epochs = ("--epochs", "3000")
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert finish(start(*epochs, "--out", str(whole)))[0] == 0
    process = start(*epochs, "--out", str(cut))
    wait_for(cut / "puma_checkpoints", process)
    process.send_signal(stop)
    status, err = finish(process)
    assert status == (130 if stop == signal.SIGINT else -signal.SIGKILL)
    assert stop == signal.SIGKILL or "the same command with --resume goes on" in err
    assert not (cut / "puma.json").exists()

    status, err = finish(start(*epochs, "--out", str(cut)))
    assert status == 2
    assert "a run was cut off here; --resume goes on with it, --force starts anew" in err
    status, err = finish(start("--epochs", "3001", "--out", str(cut), "--resume"))
    assert status == 2
    assert "is of a run with epochs 3000, not 3001" in err
    assert finish(start(*epochs, "--out", str(cut), "--resume"))[0] == 0
    assert numbers(cut) == numbers(whole)
    assert {path.name for path in cut.iterdir()} == NAMES
