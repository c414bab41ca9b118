"""Two processes learn what one learns: real ones, started as a user would start them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from support import weights_of
from torch import distributed as dist

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.errors import DataError, IkgradError
from ikgrad.training import jobs
from ikgrad.training.jobs import job_of_torchrun
from ikgrad.training.processes import Processes, meet

STEPS = 100
SHAPE = ["--robot", "ur5e", "--width", "16", "--rounds", "2", "--batch-size", "1024", "--test-rows", "100"]
COMMAND = [*SHAPE, "--steps", str(STEPS), "--checks", str(STEPS), "--checkpoint-seconds", "1e-9"]


def launch(folder: Path, *argv: str, restarts: int = 0) -> subprocess.Popen[str]:
    """Two processes, as a user would start them."""
    options = ["--standalone", "--nproc-per-node", "2", "--max-restarts", str(restarts)]
    launcher = ["-m", "torch.distributed.run", *options, "-m", "ikgrad", "train"]
    source = str(Path(ik.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": source, "OMP_NUM_THREADS": "1"}
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *launcher, *argv], cwd=folder, env=environment, **pipes)


def launched(folder: Path, *argv: str, restarts: int = 0) -> subprocess.CompletedProcess[str]:
    with launch(folder, *argv, restarts=restarts) as job:
        out, err = finished(job)
    return subprocess.CompletedProcess(job.args, job.returncode, out, err)


def finished(job: subprocess.Popen[str]) -> tuple[str, str]:
    """What it printed; what hangs is ended."""
    try:
        return job.communicate(timeout=120)
    except subprocess.TimeoutExpired:
        job.terminate()  # torchrun ends its processes
        _, err = job.communicate(timeout=60)
        pytest.fail(f"torchrun hangs: {err}")


def losses(folder: Path) -> torch.Tensor:
    rows = [line.split(",") for line in (folder / "history.csv").read_text().splitlines()[1:]]
    return torch.tensor([float(row[3]) for row in rows], dtype=torch.float64)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of two processes that are left alone, and what they printed."""
    folder = tmp_path_factory.mktemp("two")
    done = launched(folder, *COMMAND, "--out", "run", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)  # one document: the other process is silent
    assert document["members"][0]["steps"] == STEPS
    return folder / "run"


def test_two_processes_learn_what_one_learns(tmp_path: Path, two: Path):
    assert json.loads((two / "run.json").read_text())["platform"]["processes"] == 2
    settings: Any = dict(robot="ur5e", width=16, rounds=2, batch_size=1024, test_rows=100)
    ik.train(**settings, steps=STEPS, checks=STEPS, out=tmp_path / "one")
    one = losses(tmp_path / "one")
    assert len(one) > 0.9 * STEPS
    assert one[-1] < one[0]
    torch.testing.assert_close(losses(two), one, rtol=1e-6, atol=0)


# ---------------------------------------------------------------- one dies


def kill(job: subprocess.Popen[str], rank: int) -> None:
    """Kill -9 one of the processes that torchrun started."""
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == job.pid and f"RANK={rank}" in (entry / "environ").read_text().split("\0"):
                os.kill(int(entry.name), signal.SIGKILL)
                return
    pytest.fail(f"torchrun has no process of rank {rank}")


def killed_in_the_middle(folder: Path, rank: int, *argv: str, rows: int) -> tuple[int, str, str]:
    """Exit status and output of a job that loses a process once the history has so many rows."""
    with launch(folder, *argv, restarts=1) as job:
        history, end = folder / "run" / "history.csv", time.monotonic() + 100
        while not history.exists() or history.read_text().count("\n") <= rows:
            assert job.poll() is None, job.communicate()
            assert time.monotonic() < end, "no history"
            time.sleep(0.002)
        kill(job, rank)
        assert not (folder / "run" / "model").exists()  # it was in the middle
        out, err = finished(job)
    return job.returncode, out, err


linux = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds the processes in /proc")


@linux
@pytest.mark.parametrize("rank", [1, pytest.param(0, marks=pytest.mark.slow)])
def test_a_killed_process_changes_no_bit(tmp_path: Path, two: Path, rank: int):
    status, out, err = killed_in_the_middle(tmp_path, rank, *COMMAND, "--out", "run", "--json", rows=20)
    assert status == 0, err
    assert json.loads(out)["members"][0]["steps"] == STEPS  # one document: the first start printed none
    assert torch.equal(losses(tmp_path / "run"), losses(two))
    assert weights_of(tmp_path / "run") == weights_of(two) != {}


@linux
@pytest.mark.slow
def test_processes_agree_about_the_minutes_after_a_restart(tmp_path: Path):
    settings = ["--minutes", "0.04", "--checkpoint-seconds", "1e-9", "--out", "run"]
    status, _, err = killed_in_the_middle(tmp_path, 1, *SHAPE, *settings, rows=3)
    assert status == 0, err
    member = json.loads((tmp_path / "run" / "run.json").read_text())["members"][0]
    assert 2.4 <= member["seconds"] < 4.0


def test_every_start_finds_a_name_of_its_own_in_a_store_full_of_old_ones():
    store, names = dist.HashStore(), []
    for start in range(4):
        if start == 2:
            store.set("ikgrad/here/1", "one that was killed at once")
        with ThreadPoolExecutor(3) as pool:
            order = [(start + k) % 3 for k in range(3)]
            found = list(pool.map(lambda rank: meet(store, rank, 3, patience=20.0), order))
        assert len(set(found)) == 1
        names.append(found[0])
    assert len(set(names)) == 4


def test_who_does_not_come_is_not_waited_for_for_ever():
    with pytest.raises(IkgradError, match=r"1 of 2 processes did not come within 0\.1 s"):
        meet(dist.HashStore(), 0, 2, patience=0.1)


@pytest.fixture
def torchrun(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], None]:
    """Pretend that torchrun, younger than nothing, has started this process."""

    def pretend(job: str, restarts: int) -> None:
        monkeypatch.setenv("TORCHELASTIC_RUN_ID", job)
        monkeypatch.setenv("TORCHELASTIC_RESTART_COUNT", str(restarts))

    return pretend


def little(out: Path, **options: Any) -> Any:
    return ik.train(robot="ur5e", width=8, steps=3, batch_size=64, out=out, **options)


def test_a_restart_goes_on_with_what_its_job_began(tmp_path: Path, torchrun: Callable[[str, int], None]):
    torchrun("a", 0)
    first = little(tmp_path / "run", force=True)
    torchrun("a", 1)
    assert little(tmp_path / "run", force=True).seconds == first.seconds  # the same run, not made anew
    report = json.loads((tmp_path / "run" / "run.json").read_text())
    assert report["job"]["id"] == "a"


@pytest.mark.parametrize("job", ["a", "b"])
def test_a_restart_does_not_take_over_what_another_job_began(
    tmp_path: Path, torchrun: Callable[[str, int], None], monkeypatch: pytest.MonkeyPatch, job: str
):
    torchrun("a", 0)
    little(tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    if job == "a":  # the name is used again by a torchrun that was started later
        monkeypatch.setattr("ikgrad.training.jobs._started", lambda _: time.time())
    for restarts in (0, 1):
        torchrun(job, restarts)
        with pytest.raises(DataError, match="run: holds a run already; it is replaced with --force only"):
            little(tmp_path / "run")
    assert before == {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}


def test_a_run_that_is_gone_on_with_belongs_to_the_new_job(tmp_path: Path, torchrun: Callable[[str, int], None]):
    def stop(_: object) -> None:
        raise KeyboardInterrupt

    for job, options in (("a", {}), ("b", {"resume": True}), ("b", {})):
        torchrun(job, 0)
        with pytest.raises(KeyboardInterrupt):
            little(tmp_path / "run", progress=stop, **options)
        assert json.loads((tmp_path / "run" / "run.json").read_text())["job"]["id"] == job


def test_without_the_time_of_torchrun_its_counter_decides(
    torchrun: Callable[[str, int], None], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("ikgrad.training.jobs._started", lambda _: None)
    record = {"id": "a", "time": time.time()}
    for restarts in (0, 1):
        torchrun("a", restarts)
        job = job_of_torchrun(Processes())
        assert job is not None
        assert job.began(record) == (restarts > 0)


def test_this_process_was_started_in_the_past():
    assert job_of_torchrun(Processes()) is None
    started = jobs._started(os.getpid())
    assert started is None or time.time() - 7200 < started < time.time()


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
