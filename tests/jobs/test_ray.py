"""The engine on Ray: every partition once, whatever happens to actors, the same bytes as the local one, a quiet end."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from job_tasks import Noting

from ikgrad.cli.main import main
from ikgrad.errors import ConfigError, DataError, MissingExtraError
from ikgrad.jobs import ray_engine
from ikgrad.jobs.ray_engine import run_ray

NAMES = ["a", "bb", "ccc", "with space", "näme"]
TESTS = Path(__file__).parents[1]

# Not `importorskip`: ray is imported by the engine, which sets how.
pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs ikgrad[distributed]")

# What a user's program does; "stay" in the arguments is a partition that never ends.
PROGRAM = """
import signal
import sys
from pathlib import Path
from job_tasks import Noting
from ikgrad.jobs.ray_engine import run_ray

signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background may ignore it
task = Noting(Path(sys.argv[1]), {"stay": ("stay", 9), "bb": ("kill", 1)})
try:
    for record in run_ray(task, sys.argv[2:], workers=2, threads=1):
        print(record["name"], flush=True)
except KeyboardInterrupt:
    print("interrupted")
"""


def wait_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.02)


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def answers(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A cluster of two cores that somebody else runs."""
    port = free_port()
    code = f"import sys; sys.argv = {['ray', *start(port)]!r}; from ray.scripts.scripts import main; main()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "RAY_AUTH_MODE": "disabled"}
    log = tmp_path_factory.mktemp("head") / "log"
    with open(log, "w") as file:
        head = subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=file, stderr=file)
        try:
            wait_until(lambda: "ray stop" in log.read_text() or head.poll() is not None)
            assert head.poll() is None, log.read_text()
            yield f"127.0.0.1:{port}"
        finally:
            head.terminate()
            head.wait(60)


def start(port: int) -> list[str]:
    small = ["--num-cpus=2", "--num-gpus=0", f"--object-store-memory={ray_engine.STORE}", "--include-dashboard=false"]
    return ["start", "--head", "--block", f"--port={port}", *small, "--disable-usage-stats"]


def run(task: Noting, address: str, *, workers: int = 2, threads: int = 1, names: list[str] = NAMES) -> list[dict]:
    return list(run_ray(task, names, workers=workers, threads=threads, address=address))


def test_every_partition_is_done_once_and_the_connection_ended(tmp_path: Path, address: str):
    before = signal.getsignal(signal.SIGTERM)
    records = run(Noting(tmp_path), address)
    assert sorted(record["name"] for record in records) == sorted(NAMES)
    assert {record["threads"] for record in records} == {1}
    pids = {record["pid"] for record in records}
    assert os.getpid() not in pids
    assert len(pids) <= 2
    assert not sys.modules["ray"].is_initialized()
    assert signal.getsignal(signal.SIGTERM) is before
    assert not set(ray_engine.QUIET) & set(os.environ)


def test_folders_of_both_engines_are_the_same_to_the_byte(tmp_path: Path, address: str, capsys):
    poses = tmp_path / "poses"
    poses.mkdir()
    for seed in "012":
        sample = ["sample", "--robot", "ur5e", "--count", "300", "--seed", seed]
        assert main([*sample, "-o", str(poses / f"{seed}.parquet")]) == 0
    solve = ["solve", "--robot", "ur5e", str(poses), "-o"]
    assert main([*solve, str(tmp_path / "local"), "--workers", "1"]) == 0
    assert main([*solve, str(tmp_path / "ray"), "--workers", "1", "--engine", "ray", "--address", address]) == 0
    local, ray = ({path.name: path.read_bytes() for path in (tmp_path / k).glob("*.*")} for k in ("local", "ray"))
    assert sum(name.endswith(".parquet") for name in local) == 3
    assert "_manifest.json" in local
    assert local == ray


def test_killed_workers_are_replaced_and_their_partitions_done(tmp_path: Path, address: str):
    task = Noting(tmp_path, {"a": ("kill", 1)})
    records = run(task, address, threads=2)  # one at a time has room, the other waits for ever and is not missed
    assert sorted(record["name"] for record in records) == sorted(NAMES)
    assert {record["threads"] for record in records} == {2}
    assert len((tmp_path / "a.times").read_text().split()) == 1


def test_three_strikes_end_the_job_with_the_partitions_name(tmp_path: Path, address: str):
    with pytest.raises(DataError, match=r"partition 'bb': 3 workers died over it.*killed, maybe for want of memory"):
        run(Noting(tmp_path, {"bb": ("kill", 9)}), address)
    assert len((tmp_path / "bb.times").read_text().split()) == 3


@pytest.mark.parametrize(
    ("kind", "error", "text"),
    [
        ("unpicklable", DataError, r"^unknown robot 'pandda'; did you mean 'panda'\?"),
        ("full", OSError, r"^\[Errno 28\] No space left on device: 'x\.parquet'$"),
        ("bug", RuntimeError, r"(?s)^Traceback.*in _suffer.*ZeroDivisionError: one over zero"),
    ],
)
def test_an_error_of_the_task_comes_back_as_it_was(tmp_path: Path, address: str, kind, error, text):
    with pytest.raises(error, match=text):
        run(Noting(tmp_path, {"a": (kind, 9)}), address, workers=1)
    assert len((tmp_path / "a.times").read_text().split()) == 1  # an error is an answer, no reason to try again


def test_a_cluster_that_is_too_small_or_has_another_version_is_refused(tmp_path: Path, address: str, monkeypatch):
    with pytest.raises(ConfigError, match="has 2 cores, but one worker is to have 3 threads"):
        run(Noting(tmp_path), address, threads=3)
    monkeypatch.setattr(ray_engine, "__version__", "9.9")
    with pytest.raises(ConfigError, match=r"in the Ray cluster has ikgrad \d.*, this machine 9\.9; install the same"):
        run(Noting(tmp_path), address)


def test_a_cluster_of_our_own_is_quiet_and_gone_after_ctrl_c(tmp_path: Path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *sys.path])}
    command = [sys.executable, "-W", "error", "-c", PROGRAM, str(tmp_path), "bb", "stay", "ccc"]
    pipe = subprocess.PIPE
    program = subprocess.Popen(command, env=environment, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    try:
        assert program.stdout is not None
        assert {program.stdout.readline().strip() for _ in range(2)} == {"bb", "ccc"}
        wait_until((tmp_path / "stay.times").exists)
        [own] = Path("/tmp").glob(f"ikgrad-ray-*/session_*_{program.pid}")
        os.killpg(program.pid, signal.SIGINT)  # what a terminal sends: to the driver and to all that it started
        assert program.communicate(timeout=60) == ("interrupted\n", "")
    finally:
        program.kill()
    assert not own.parent.exists()
    stuck = int((tmp_path / "stay.times").read_text())
    wait_until(lambda: not Path(f"/proc/{stuck}").exists() or "Z" in Path(f"/proc/{stuck}/stat").read_text().split())


def test_an_address_where_nothing_listens_is_refused(tmp_path: Path):
    port = free_port()
    with pytest.raises(ConfigError, match=rf"no Ray cluster answers at 127\.0\.0\.1:{port} .*'ray start --head --port"):
        run(Noting(tmp_path), f"127.0.0.1:{port}")
    assert not answers(port)


@pytest.mark.parametrize("wrong", ["somewhere", ":6379", "host:port", ""])
def test_an_address_is_auto_or_a_host_with_a_port(tmp_path: Path, wrong: str):
    with pytest.raises(ConfigError, match=f"'auto' or HOST:PORT, got '{wrong}'"):
        run(Noting(tmp_path), wrong)


def test_nothing_to_do_starts_nothing(tmp_path: Path):
    assert list(run_ray(Noting(tmp_path), [], workers=2, threads=1, address="nowhere")) == []


@pytest.mark.parametrize("numbers", [{"workers": 0, "threads": 1}, {"workers": 1, "threads": 0}])
def test_at_least_one_of_each(tmp_path: Path, numbers):
    with pytest.raises(ConfigError, match="must be at least 1, got"):
        list(run_ray(Noting(tmp_path), NAMES, **numbers))


def test_without_ray_the_extra_is_named(tmp_path: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"Ray clusters need ray; pip install 'ikgrad\[distributed\]'"):
        list(run_ray(Noting(tmp_path), NAMES, workers=1, threads=1))
