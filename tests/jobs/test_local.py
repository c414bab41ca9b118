"""The local engine: every partition once, whatever happens to workers."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from job_folders import alive, wait_until
from job_tasks import Noting

from ikgrad.errors import ConfigError, DataError
from ikgrad.jobs import run_local

NAMES = ["a", "bb", "ccc", "with space", "näme"]


def test_every_partition_is_done_once_by_processes_of_the_team(tmp_path: Path):
    records = list(run_local(Noting(tmp_path), NAMES, workers=2, threads=1))
    assert sorted(record["name"] for record in records) == sorted(NAMES)
    assert {record["threads"] for record in records} == {1}
    pids = {record["pid"] for record in records}
    assert os.getpid() not in pids
    assert len(pids) <= 2
    assert not any(map(alive, pids))


def test_threads_reach_the_workers(tmp_path: Path):
    [record] = run_local(Noting(tmp_path), ["a"], workers=9, threads=2)
    assert record["threads"] == 2


def test_nothing_to_do_starts_nothing(tmp_path: Path):
    assert list(run_local(Noting(tmp_path), [], workers=2, threads=1)) == []


def test_a_killed_worker_is_replaced_and_its_partition_done(tmp_path: Path):
    task = Noting(tmp_path, {"bb": ("kill", 2)})
    records = list(run_local(task, NAMES, workers=2, threads=1))
    assert sorted(record["name"] for record in records) == sorted(NAMES)
    assert len(set((tmp_path / "bb.times").read_text().split())) == 2


def test_three_strikes_end_the_job_with_the_partitions_name(tmp_path: Path):
    task = Noting(tmp_path, {"bb": ("kill", 9)})
    with pytest.raises(DataError, match=r"partition 'bb': 3 workers died over it.*killed, maybe for want of memory"):
        list(run_local(task, NAMES, workers=1, threads=1))
    assert (tmp_path / "a.done").exists()
    assert len((tmp_path / "bb.times").read_text().split()) == 3


@pytest.mark.parametrize(
    ("kind", "error", "text"),
    [
        ("data", DataError, r"^x\.parquet: is damaged$"),
        ("unpicklable", DataError, r"unknown robot 'pandda'; did you mean 'panda'\?"),
        ("full", OSError, r"\[Errno 28\] No space left on device: 'x\.parquet'"),
        ("bug", RuntimeError, r"(?s)Traceback.*in _suffer.*ZeroDivisionError: one over zero"),
    ],
)
def test_an_error_of_the_task_comes_back_as_it_was(tmp_path: Path, kind, error, text):
    with pytest.raises(error, match=text):
        list(run_local(Noting(tmp_path, {"a": (kind, 9)}), NAMES, workers=1, threads=1))
    assert len((tmp_path / "a.times").read_text().split()) == 1  # an error is an answer, no reason to try again


def test_closing_the_iterator_stops_busy_workers(tmp_path: Path):
    before = set(threading.enumerate())
    running = run_local(Noting(tmp_path, {"stuck": ("stay", 9)}), ["a", "stuck", "b"], workers=2, threads=1)
    next(running)
    wait_until((tmp_path / "stuck.times").exists)
    wait_until(lambda: (tmp_path / "stuck.times").read_text().endswith("\n"))
    running.close()
    assert not alive(int((tmp_path / "stuck.times").read_text()))
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("numbers", [{"workers": 0, "threads": 1}, {"workers": 1, "threads": 0}])
def test_at_least_one_of_each(tmp_path: Path, numbers):
    with pytest.raises(ConfigError, match="must be at least 1, got"):
        list(run_local(Noting(tmp_path), NAMES, **numbers))
