"""Two processes learn what one learns: real ones, started as a user would start them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.training.processes import Processes

SETTINGS = ["--robot", "ur5e", "--width", "16", "--rounds", "2", "--batch-size", "1024", "--steps", "50"]
COMMAND = [*SETTINGS, "--checks", "50", "--test-rows", "100"]


def launched(folder: Path, *argv: str, processes: int = 2) -> subprocess.CompletedProcess[str]:
    launcher = ["-m", "torch.distributed.run", "--nproc-per-node", str(processes), "-m", "ikgrad", "train"]
    source = str(Path(ik.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": source, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *launcher, *argv], capture_output=True, text=True, cwd=folder, env=environment, timeout=200
    )


def losses(folder: Path) -> torch.Tensor:
    rows = [line.split(",") for line in (folder / "history.csv").read_text().splitlines()[1:]]
    return torch.tensor([float(row[3]) for row in rows], dtype=torch.float64)


def test_two_processes_learn_what_one_learns(tmp_path: Path):
    done = launched(tmp_path, *COMMAND, "--out", "two", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)  # one document: the other process is silent
    assert document["members"][0]["steps"] == 50
    assert json.loads((tmp_path / "two" / "run.json").read_text())["platform"]["processes"] == 2
    ik.train(
        robot="ur5e", width=16, rounds=2, batch_size=1024, steps=50, checks=50, test_rows=100, out=tmp_path / "one"
    )
    one, two = losses(tmp_path / "one"), losses(tmp_path / "two")
    assert len(one) > 40
    assert one[-1] < one[0]
    torch.testing.assert_close(two, one, rtol=1e-6, atol=0)


@pytest.mark.slow
def test_mistakes_under_torchrun_are_told_once(tmp_path: Path):
    (tmp_path / "taken").write_text("")
    done = launched(tmp_path, *COMMAND, "--out", "taken")
    assert done.returncode != 0
    assert done.stderr.count("taken: is a file, not a folder") == 1
    assert "Traceback" not in done.stderr.split("failed (exitcode: 2)")[0]


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_every_row_is_one_process_own(size: int):
    shares = [Processes(rank, size).rows(17) for rank in range(size)]
    assert [row for share in shares for row in range(17)[share]] == list(range(17))
    stream = TaskStream(ik.load_robot("panda"), batch_size=17, label="solver")
    parts = [stream.batch(3, rows=share) for share in shares]
    for whole, part in zip(stream.batch(3), zip(*parts, strict=True), strict=True):
        assert torch.equal(whole, torch.cat(part))


def test_processes_without_rows_are_refused():
    with pytest.raises(ik.ConfigError, match="batch_size 2 is too small for 3 processes; each needs a row"):
        Processes(0, 3).rows(2)


def test_alone_nothing_is_shared():
    alone = Processes()
    numbers = torch.arange(3.0)
    assert alone.add_up(numbers) is numbers
    assert (alone.from_first(4.5), alone.on_first(lambda: "x"), alone.first) == (4.5, "x", True)


def test_the_classic_model_does_not_share(monkeypatch):
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ik.ConfigError, match="model classic trains in one process; start it without torchrun"):
        ik.train(robot="ur5e", model="classic")
