"""Studies that are cut off, by a kill or by Ctrl-C, go on to the same report."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from support import without_times

from ikgrad.cli.main import main
from ikgrad.cli.reproduce import denso, puma
from ikgrad.data import SmoothPath
from ikgrad.errors import DataError
from ikgrad.papers.denso.arm import HOME
from ikgrad.papers.denso.networks import make_data, train
from ikgrad.training import load_checkpoint

RUN = """
import sys
from ikgrad.cli.main import main
from ikgrad.papers import resume
resume.CHECKPOINT_EVERY = float(sys.argv[1])
sys.exit(main(sys.argv[2:]))
"""


@dataclass(frozen=True)
class Case:
    """A short study, the checkpoint whose first appearance is the moment to stop it, and a wrong way to go on."""

    paper: str
    options: tuple[str, ...]
    every: float
    stop_at: str
    other: tuple[str, ...]
    refusal: str
    files: tuple[str, ...]


CASES = [
    Case(
        "puma",
        ("--seeds", "2", "--epochs", "3000"),
        0.3,
        "[!.]*.ckpt",  # not the temporary file
        ("--seeds", "2", "--epochs", "3001"),
        "is of a run with epochs 3000, not 3001; --force starts anew",
        puma.FILES,
    ),
    Case(
        "denso",
        ("--config", "{tmp}/short.yaml"),
        0.0,
        "scheme_a_feedback.ckpt",  # scheme B is done then, and is not trained again
        ("--config", "{tmp}/short.yaml", "--seeds", "3"),
        "is of a run with seeds [0, 1], not [0, 1, 2]; --force starts anew",
        denso.FILES,
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resume")
    settings = dict(traditional_epochs=3, feedback_epochs=3, epochs=3, cure_epochs=2, final_epochs=2, ticks=50)
    lines = [f"{key}: {value}\n" for key, value in {"seeds": 2, **settings}.items()]
    (folder / "short.yaml").write_text("".join(lines))
    return folder


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case.paper)
def whole(request: pytest.FixtureRequest, folder: Path) -> tuple[Case, Any]:
    """A case, and the report of its uninterrupted run."""
    case, out = request.param, folder / f"whole_{request.param.paper}"
    assert main(command(case.paper, case.options, out)) == 0
    return case, report(case, out)


def command(paper: str, options: tuple[str, ...], out: Path) -> list[str]:
    return ["reproduce", paper, *(option.format(tmp=out.parent) for option in options), "--out", str(out)]


def report(case: Case, out: Path) -> Any:
    return without_times(json.loads((out / f"{case.paper}.json").read_text()))


def cut_off(case: Case, out: Path, stop: signal.Signals) -> tuple[int, str]:
    """Status and errors of a run that gets a signal when a certain checkpoint appears."""
    started = subprocess.Popen(
        [sys.executable, "-c", RUN, str(case.every), *command(case.paper, case.options, out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 100
    while not list((out / f"{case.paper}_checkpoints").glob(case.stop_at)):
        assert started.poll() is None, started.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    started.send_signal(stop)
    _, err = started.communicate(timeout=200)
    return started.returncode, err


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_was_cut_off_goes_on_to_the_same_report(
    whole: tuple[Case, Any], stop: signal.Signals, folder: Path, capsys: pytest.CaptureFixture[str]
):
    case, expected = whole
    out = folder / f"{case.paper}_{stop.name}"
    status, err = cut_off(case, out, stop)
    assert status == (130 if stop == signal.SIGINT else -signal.SIGKILL)
    assert stop == signal.SIGKILL or "the same command with --resume goes on" in err
    assert not (out / f"{case.paper}.json").exists()

    assert main(command(case.paper, case.options, out)) == 2
    assert "a run was cut off here; --resume goes on with it, --force starts anew" in capsys.readouterr().err
    assert main([*command(case.paper, case.other, out), "--resume"]) == 2
    assert case.refusal in capsys.readouterr().err
    assert main([*command(case.paper, case.options, out), "--resume"]) == 0
    assert report(case, out) == expected
    assert {path.name for path in out.iterdir()} == set(case.files)


def test_a_training_of_the_denso_study_goes_on_from_its_checkpoint_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Cut off twice; epochs are counted once each."""
    monkeypatch.setattr("ikgrad.papers.resume.CHECKPOINT_EVERY", 0.0)
    data = make_data([SmoothPath(home=HOME, count=400, seed=seed) for seed in range(2)])
    whole, _ = train("feedback", data, 12, seeds=range(2))
    file, counted = tmp_path / "c.ckpt", [0]

    def cut(networks: int) -> None:
        counted.append(networks)
        if len(counted) % 4 == 0:
            raise KeyboardInterrupt

    for epochs in (3, 6):  # done when it is cut off; the first call of the second run speaks for three
        with pytest.raises(KeyboardInterrupt):
            train("feedback", data, 12, seeds=range(2), count=cut, checkpoint=file)
        assert load_checkpoint(file)["training"]["progress"]["epoch"] == epochs
        counted[:] = [0]
    counted.clear()
    resumed, _ = train("feedback", data, 12, seeds=range(2), count=counted.append, checkpoint=file)
    assert sum(counted) == 2 * 12
    assert resumed.seconds > 0.0
    for name in ("mse", "regression", "position_mm", "curve_train", "curve_validation"):
        assert torch.equal(getattr(resumed, name), getattr(whole, name)), name
    twice, _ = train("feedback", data, 12, seeds=range(2), checkpoint=file)  # nothing is left to do
    assert torch.equal(twice.mse, whole.mse)


def test_checkpoints_of_other_data_or_damaged_ones_are_refused(tmp_path: Path):
    file = tmp_path / "c.ckpt"
    data = make_data([SmoothPath(home=HOME, count=100)])
    train("traditional", data, 2, seeds=[0], checkpoint=file)
    with pytest.raises(DataError, match=r"is of a run with network traditional, not feedback; --force starts anew"):
        train("feedback", data, 2, seeds=[0], checkpoint=file)
    with pytest.raises(DataError, match=r"is of a run with data [0-9a-f]{12}, not [0-9a-f]{12}; --force"):
        train("traditional", make_data([SmoothPath(home=HOME, count=100, seed=1)]), 2, seeds=[0], checkpoint=file)
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(DataError, match="truncated or was changed"):
        train("traditional", data, 2, seeds=[0], checkpoint=file)
