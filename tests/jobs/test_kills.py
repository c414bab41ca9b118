"""`ikgrad solve` on a folder while processes are killed, interrupted, or out of space; real ones, at chosen moments."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from job_folders import alive, hard_poses, hashes, solve_here, task_of, wait_until, write_folder

import ikgrad as ik
from ikgrad.jobs.manifest import finish

NAMES = [f"p{k}" for k in range(5)]
COMMAND = """
import signal, sys
import ikgrad.jobs.solving
from job_gate import GatedSolve
from ikgrad.cli.main import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background may ignore it
ikgrad.jobs.solving.SolveTask = GatedSolve
sys.exit(main())
"""

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("puma560")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, robot) -> Path:
    """``poses``, and in ``whole`` what comes of them."""
    place = tmp_path_factory.mktemp("jobs")
    write_folder(place / "poses", dict(zip(NAMES, hard_poses(robot, 500).split(100), strict=True)))
    task = task_of(robot, place / "poses", place / "whole")
    solve_here(task)
    assert finish(task.output, task.job()) == []
    return place


class Command:
    """A running command."""

    def __init__(self, poses: Path, output: Path, gate: Path, *options: str, hold: str):
        self.gate, self.hold = gate, gate / f"{hold}.hold"
        gate.mkdir()
        self.hold.touch()
        arguments = ["solve", "--robot", "puma560", str(poses), "-o", str(output), "--workers", "2", *options]
        path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "GATE": str(gate), "PYTHONPATH": path},
        )

    def pids(self, name: str) -> list[int]:
        path = self.gate / f"{name}.pids"
        return [int(line) for line in path.read_text().split("\n")[:-1]] if path.exists() else []

    def everybody(self) -> set[int]:
        return {pid for name in NAMES for pid in self.pids(name)}

    def until_held(self, records: Path, count: int) -> None:
        """Until a worker stands at the gate and so many partitions are finished."""
        name = self.hold.stem
        wait_until(lambda: (bool(self.pids(name)) and len(list(records.glob("[!.]*"))) >= count) or self.ended())

    def ended(self) -> bool:
        if self.process.poll() is not None:
            pytest.fail(f"it ended: {self.process.communicate()}")
        return False


@pytest.fixture
def start(tmp_path: Path, undisturbed) -> Iterator:
    begun: list[Command] = []

    def make(*options: str, hold: str) -> Command:
        begun.append(Command(undisturbed / "poses", tmp_path / "out", tmp_path / "gate", *options, hold=hold))
        return begun[-1]

    yield make
    for command in begun:
        if command.process.poll() is None:
            command.process.kill()
            command.process.communicate()


def resumed(robot, undisturbed: Path, out: Path) -> list[str]:
    """Go on where it stopped; the partitions that were still to do."""
    task = task_of(robot, undisturbed / "poses", out)
    records = solve_here(task, resume=True)
    assert finish(task.output, task.job()) == []
    assert hashes(out) == hashes(undisturbed / "whole")
    assert not list(out.rglob(".*"))
    return [name for name, record in records.items() if record["fresh"]]


def test_a_killed_worker_changes_nothing(start, tmp_path, undisturbed):
    command = start("--json", hold="p2")
    command.until_held(tmp_path / "out/_records", 3)
    [victim] = command.pids("p2")
    os.kill(victim, signal.SIGKILL)
    command.hold.unlink()
    out, err = command.process.communicate(timeout=120)
    assert command.process.returncode == 0, err
    assert json.loads(out)["done"] == 5
    assert len(command.pids("p2")) == 2
    assert command.pids("p2")[1] != victim
    assert hashes(tmp_path / "out") == hashes(undisturbed / "whole")
    assert not list((tmp_path / "out").rglob(".*"))


def test_a_killed_driver_takes_its_workers_along_and_the_job_can_be_resumed(start, tmp_path, undisturbed, robot):
    command = start(hold="p1")
    command.until_held(tmp_path / "out/_records", 2)
    command.process.kill()
    command.process.communicate(timeout=120)
    wait_until(lambda: not any(map(alive, command.everybody())))
    assert not (tmp_path / "out/p1.parquet").exists()
    assert not (tmp_path / "out/_manifest.json").exists()
    assert "p1" in resumed(robot, undisturbed, tmp_path / "out")


def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(start, tmp_path, undisturbed, robot):
    command = start(hold="p1")
    command.until_held(tmp_path / "out/_records", 4)
    command.process.send_signal(signal.SIGINT)
    out, err = command.process.communicate(timeout=120)
    assert command.process.returncode == 130
    assert out == ""
    assert err.splitlines()[-1] == (
        f"ikgrad: interrupted; 4 of 5 partitions are finished and kept in {tmp_path}/out, "
        "the same command with --resume goes on from there"
    )
    assert "Traceback" not in err
    assert not any(map(alive, command.everybody()))
    assert resumed(robot, undisturbed, tmp_path / "out") == ["p1"]


FULL = """
mount -t tmpfs -o size=52k,mode=755 none "$OUT" || exit 99
mkdir "$OUT/joints"
"$PYTHON" -m ikgrad solve --robot puma560 "$POSES" -o "$OUT/joints" --workers 2 > "$LOG/out" 2> "$LOG/err"
echo $? > "$LOG/status"
ls -AR "$OUT/joints" > "$LOG/left"
mount -o remount,size=9m "$OUT"
"$PYTHON" -m ikgrad solve --robot puma560 "$POSES" -o "$OUT/joints" --workers 2 --resume --json > "$LOG/json" || exit 98
cp -r "$OUT/joints" "$LOG/joints"
"""


@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs a file system of its own")
def test_a_full_disk_stops_with_one_line_and_the_job_goes_on_when_there_is_room(tmp_path, undisturbed):
    log, place = tmp_path / "log", tmp_path / "small"
    log.mkdir()
    place.mkdir()
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
    names = {"OUT": place, "LOG": log, "POSES": undisturbed / "poses", "PYTHON": sys.executable, "PYTHONPATH": path}
    ended = subprocess.run(
        ["unshare", "-rm", "sh", "-c", FULL], env={**os.environ, **{key: str(value) for key, value in names.items()}}
    )
    if not (log / "status").exists():
        pytest.skip("no file system of its own here")
    assert ended.returncode == 0
    assert (log / "status").read_text() == "2\n"
    assert (log / "out").read_text() == ""
    said = [line for line in (log / "err").read_text().splitlines() if "ikgrad: solve: " not in line]
    assert len(said) == 1
    assert "No space left on device; " in said[0]
    assert "the same command with --resume" in said[0]
    left = (log / "left").read_text()
    assert ".tmp" not in left
    partitions = left.count(".parquet")
    assert 1 <= partitions < 5
    document = json.loads((log / "json").read_text())
    assert document["done"] + document["found_finished"] == 5
    assert document["found_finished"] >= 1
    assert hashes(log / "joints") == hashes(undisturbed / "whole")
