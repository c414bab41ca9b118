"""Shards put together: nothing is missing, nothing is there twice, nothing is lost on the way."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from job_folders import hard_poses, hashes, solve_here, task_of, write_folder
from support import Killed

import ikgrad as ik
from ikgrad.errors import DataError
from ikgrad.jobs.manifest import finish
from ikgrad.jobs.merge import merge
from ikgrad.jobs.partitions import Shard

NAMES = ["a", "b", "c", "d"]


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("puma560")


@pytest.fixture
def place(tmp_path: Path, robot) -> Path:
    """``poses``, all of it solved in ``whole``, and by three shards in folders ``s1`` to ``s3``."""
    write_folder(tmp_path / "poses", dict(zip(NAMES, hard_poses(robot, 40).split(10), strict=True)))
    task = task_of(robot, tmp_path / "poses", tmp_path / "whole")
    solve_here(task)
    finish(task.output, task.job())
    for k in (1, 2, 3):
        solve_here(task_of(robot, tmp_path / "poses", tmp_path / f"s{k}"), Shard(k, 3).of(NAMES))
    return tmp_path


def shards(place: Path) -> list[Path]:
    return [place / f"s{k}" for k in (1, 2, 3)]


def test_shards_of_one_folder_are_verified_and_get_their_manifest(place: Path, robot):
    (place / "whole/_manifest.json").unlink()
    rows: list[int] = []
    merged = merge([place / "whole"], place / "whole", advance=rows.append)
    assert sum(rows) == 40
    assert merged.moved == 0
    assert merged.totals["rows"] == 40
    task = task_of(robot, place / "poses", place / "again")
    solve_here(task)
    finish(task.output, task.job())
    assert hashes(place / "whole") == hashes(place / "again")


@pytest.mark.parametrize("copy", [False, True])
def test_shards_of_several_folders_come_together(place: Path, copy):
    before = [hashes(shard) for shard in shards(place)]
    merged = merge(shards(place), place / "out", copy=copy)
    assert merged.moved == 4
    assert hashes(place / "out") == hashes(place / "whole")
    if copy:
        assert [hashes(shard) for shard in shards(place)] == before
    else:
        assert not any(shard.exists() for shard in shards(place))
    assert merge(shards(place), place / "out", copy=copy).moved == 0  # the same again
    assert hashes(place / "out") == hashes(place / "whole")


def test_one_of_the_shards_may_be_the_output(place: Path):
    assert merge(shards(place), place / "s2").moved == 3
    assert hashes(place / "s2") == hashes(place / "whole")
    assert not (place / "s1").exists()


def test_other_file_systems_get_copies(place: Path, monkeypatch):
    real = os.replace

    def refuse(source: Path, target: Path) -> None:
        if not Path(source).name.startswith("."):
            raise OSError(18, "Invalid cross-device link")
        real(source, target)

    monkeypatch.setattr("os.replace", refuse)
    assert merge(shards(place), place / "out").moved == 4
    assert hashes(place / "out") == hashes(place / "whole")
    assert not (place / "s1").exists()


def test_a_partition_twice_with_the_same_content_is_there_once(place: Path):
    merge([place / "whole", *shards(place)], place / "out")
    assert sorted(path.name for path in (place / "out").glob("*.parquet")) == [f"{name}.parquet" for name in NAMES]
    assert not any(shard.exists() for shard in [*shards(place), place / "whole"])


@pytest.mark.parametrize("copy", [False, True])
@pytest.mark.parametrize("system_call", ["replace", "unlink"])
def test_a_merge_that_is_killed_anywhere_can_be_called_again(place: Path, monkeypatch, copy, system_call):
    for stop in range(1, 100):
        left = [stop]
        module, real = (os, os.replace) if system_call == "replace" else (Path, Path.unlink)

        def kill(*arguments, left=left, real=real, **options):
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return real(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(module, system_call, kill)
            try:
                merge(shards(place), place / "out", copy=copy)
            except Killed:
                continue
        break
    assert stop > 2  # every call comes a little further
    merge(shards(place), place / "out", copy=copy)
    for path in (place / "out").rglob(".*.tmp*"):  # of this process, which was not really killed
        real(path) if system_call == "unlink" else path.unlink()
    assert hashes(place / "out") == hashes(place / "whole")


# ---------------------------------------------------------------- refusals, before anything is moved


def refused(place: Path, folders: list[Path], message: str) -> None:
    before = [hashes(folder) for folder in folders]
    with pytest.raises(DataError, match=message):
        merge(folders, place / "out")
    assert [hashes(folder) for folder in folders] == before
    assert not (place / "out").exists()


def test_what_is_missing_is_listed(place: Path):
    refused(place, shards(place)[1:], r"partitions 'a', 'd' are missing of 4 in .*s2, .*s3; do the shards again")
    refused(place, [place / "s2"], r"partitions 'a', 'c', 'd' are missing of 4")


def test_what_is_damaged_is_listed(place: Path):
    path = place / "s1/d.parquet"
    whole = bytearray(path.read_bytes())
    whole[40] ^= 255
    path.write_bytes(whole)
    refused(place, shards(place), r"partition 'd' in .*s1 does not hold what was written; do the shard again")


def test_a_damaged_one_is_no_loss_if_there_is_another(place: Path):
    (place / "s1/d.parquet").write_bytes(b"")
    merge([*shards(place), place / "whole"], place / "out", copy=True)
    assert hashes(place / "out") == hashes(place / "whole")


def test_two_contents_of_a_partition_are_refused(place: Path, robot):
    task = task_of(robot, place / "poses", place / "whole")
    (place / "whole/b.parquet").write_bytes(b"other")
    record = task.output.records(["b"])["b"]
    import hashlib

    task.output.keep(record | {"bytes": 5, "sha256": hashlib.sha256(b"other").hexdigest()})
    refused(place, [*shards(place), place / "whole"], "partition 'b' is there more than once, with different content")


def test_other_jobs_are_refused(place: Path, robot):
    solve_here(task_of(robot, place / "poses", place / "other", seed=3), ["a"])
    refused(place, [*shards(place), place / "other"], r"other: is a shard of another job than .*s1: seed was 0, is 3")


def test_strange_partitions_and_folders_without_a_job_are_refused(place: Path):
    (place / "s1/z.parquet").write_bytes(b"")
    refused(place, shards(place), "s1: partition 'z' is no part of this job and must not lie there")
    refused(place, [place / "poses"], r"poses: holds no job \(_job\.json is not there\)")
    refused(place, [place / "poses", place / "s2"], "poses: holds no job")


def test_a_shard_that_had_nothing_to_do_is_welcome(place: Path, robot):
    solve_here(task_of(robot, place / "poses", place / "idle"), [])
    merge([*shards(place), place / "idle"], place / "out")
    assert hashes(place / "out") == hashes(place / "whole")
    assert not (place / "idle").exists()
