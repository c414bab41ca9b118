"""Output folders: what belongs together, what is finished, what is ours."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from job_folders import hard_poses, hashes, solve_here, task_of, write_folder

import ikgrad as ik
from ikgrad.errors import DataError
from ikgrad.files.places import HOST
from ikgrad.jobs.folder import JobFolder
from ikgrad.jobs.manifest import finish

NAMES = ["a", "b", "c"]
JOB = {"job": "nothing", "seed": 1, "partitions": {name: {"rows": 5} for name in NAMES}}


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("puma560")


@pytest.fixture
def place(tmp_path: Path, robot) -> Path:
    """A folder with three partitions of poses, which are solved in ``done``."""
    poses = hard_poses(robot, 60)
    write_folder(tmp_path / "poses", dict(zip(NAMES, poses.split(20), strict=True)))
    task = task_of(robot, tmp_path / "poses", tmp_path / "done")
    solve_here(task)
    finish(task.output, task.job())
    return tmp_path


def keep(folder: JobFolder, name: str, text: bytes = b"rows") -> None:
    import hashlib

    folder.partition(name).write_bytes(text)
    folder.keep({"name": name, "rows": 5, "bytes": len(text), "sha256": hashlib.sha256(text).hexdigest()})


def test_finished_partitions_are_verified_and_left_alone(place: Path, robot):
    before = hashes(place / "done")
    times = {path: path.stat().st_mtime_ns for path in (place / "done").rglob("*.*")}
    records = solve_here(task_of(robot, place / "poses", place / "done"), resume=True)
    assert [record["fresh"] for record in records.values()] == [False] * 3
    assert hashes(place / "done") == before
    assert {path: path.stat().st_mtime_ns for path in (place / "done").rglob("*.*")} == times


def spoil(folder: Path, how: str) -> None:
    path, record = folder / "b.parquet", folder / "_records/b.json"
    if how == "corrupted":
        whole = bytearray(path.read_bytes())
        whole[len(whole) // 2] ^= 1
        path.write_bytes(whole)
    elif how == "truncated":
        path.write_bytes(path.read_bytes()[:-9])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "removed":
        path.unlink()
    elif how == "record removed":
        record.unlink()
    elif how == "record of another":
        record.write_bytes((folder / "_records/a.json").read_bytes())
    else:
        record.write_text({"record cut": record.read_text()[:40], "record empty": "", "record strange": "[1]"}[how])


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("corrupted", "does not hold what was written"),
        ("truncated", r"has [\d,]+ bytes, had [\d,]+"),
        ("empty", "has 0 bytes, had"),
        ("removed", "is gone"),
        ("record removed", None),
        ("record cut", "has a damaged record"),
        ("record empty", "has a damaged record"),
        ("record strange", "has a damaged record"),
        ("record of another", "has a damaged record"),
    ],
)
def test_what_is_not_as_it_was_is_done_again(place: Path, robot, how, said):
    before = hashes(place / "done")
    spoil(place / "done", how)
    task = task_of(robot, place / "poses", place / "done")
    records = solve_here(task, resume=True)
    assert {name: record["fresh"] for name, record in records.items()} == {"a": False, "b": True, "c": False}
    if said is None:
        assert "redone" not in records["b"]
    else:
        import re

        assert re.match(said, records["b"]["redone"])
    assert finish(task.output, task.job()) == []
    assert hashes(place / "done") == before


# ---------------------------------------------------------------- whose folder it is


def test_a_folder_that_was_begun_asks_for_resume_or_force(tmp_path: Path):
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    folder.begin(JOB, NAMES)  # nothing is lost by beginning again
    keep(folder, "a")
    with pytest.raises(DataError, match="holds an unfinished job; --resume goes on with it, --force starts anew"):
        folder.begin(JOB, NAMES)
    folder.begin(JOB, ["b", "c"])  # another shard
    folder.begin(JOB, NAMES, resume=True)
    keep(folder, "b")
    keep(folder, "c")
    assert finish(folder, JOB) == []
    with pytest.raises(DataError, match="holds a finished job; --resume verifies it, --force starts anew"):
        folder.begin(JOB, NAMES)


def test_force_starts_anew_and_removes_only_what_is_ours(tmp_path: Path):
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    keep(folder, "a")
    (folder.path / ".hidden").write_text("precious")
    other = JOB | {"seed": 2, "partitions": {"z": {"rows": 5}}}
    folder.begin(other, ["z"], force=True)
    assert folder.read_job() == other
    assert sorted(path.name for path in folder.path.iterdir()) == [".hidden", "_job.json", "_records"]
    assert list((folder.path / "_records").iterdir()) == []


def test_force_of_a_shard_removes_its_own_partitions_only(tmp_path: Path):
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    for name in NAMES:
        keep(folder, name)
    folder.begin(JOB, ["a", "c"], force=True)
    assert sorted(path.name for path in folder.path.glob("*.parquet")) == ["b.parquet"]
    with pytest.raises(DataError, match="seed was 1, is 2; --force without --shard starts anew"):
        folder.begin(JOB | {"seed": 2}, ["a"], force=True)
    assert folder.check("b").record is not None


def test_files_of_others_are_refused_also_with_force(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("precious")
    for force in (False, True):
        with pytest.raises(DataError, match=r"holds 'notes\.txt' and no job; choose a new or an empty folder"):
            JobFolder(tmp_path).begin(JOB, NAMES, force=force)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_places_that_cannot_be(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="file: is a file, not a folder"):
        JobFolder(tmp_path / "file").begin(JOB, NAMES)
    with pytest.raises(DataError, match=r"the folder '.*none' does not exist; create it first"):
        JobFolder(tmp_path / "none/out").begin(JOB, NAMES)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"partitions": 3}'])
def test_a_description_that_cannot_be_read(tmp_path: Path, text):
    (tmp_path / "_job.json").write_text(text)
    with pytest.raises(DataError, match="--force starts anew"):
        JobFolder(tmp_path).begin(JOB, NAMES, resume=True)
    JobFolder(tmp_path).begin(JOB, NAMES, force=True)
    assert JobFolder(tmp_path).read_job() == JOB


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 2}, "seed was 1, is 2"),
        ({"ikgrad version": "9"}, "ikgrad version was None, is 9"),
        ({"partitions": {"a": {"rows": 5}, "b": {"rows": 5}}}, "partition 'c' is gone"),
        ({"partitions": {**JOB["partitions"], "d": {"rows": 5}}}, "partition 'd' is new"),
        ({"partitions": {**JOB["partitions"], "b": {"rows": 6}}}, "rows of partition 'b' was 5, is 6"),
        ({"partitions": {f"z{k}": {"rows": 1} for k in range(9)}}, "and 9 more differences"),
    ],
)
def test_another_job_is_refused_with_what_differs(tmp_path: Path, change, said):
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    for how in ({}, {"resume": True}):
        with pytest.raises(DataError, match=f"cannot go on with another job: .*{said}.*; --force starts anew"):
            folder.begin(JOB | change, list((JOB | change)["partitions"]), **how)


def test_another_robot_or_setting_is_another_job(place: Path, robot):
    longer = robot.with_tool([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]])
    for other, settings, said in [
        (longer, {}, r"robot fingerprint was \w+, is \w+$"),
        (robot, {"seed": 1}, "seed was 0, is 1"),
        (robot, {"tol_pos": 1e-5}, "tol_pos was 1e-06, is 1e-05"),
        (robot, {"solver": ik.LevenbergMarquardt(max_starts=3)}, "solver was LevenbergMarquardt"),
    ]:
        task = task_of(other, place / "poses", place / "done", **settings)
        with pytest.raises(DataError, match="; ".join(["cannot go on"]) + f".*{said.rstrip('$')}"):
            task.output.begin(task.job(), NAMES, resume=True)


def test_other_inputs_are_another_job(place: Path, robot):
    write_folder(place / "poses", {"b": hard_poses(robot, 20, seed=9)})
    task = task_of(robot, place / "poses", place / "done")
    with pytest.raises(DataError, match=r"footer of partition 'b' was \w+, is \w+; --force"):
        task.output.begin(task.job(), NAMES, resume=True)


# ---------------------------------------------------------------- several processes


def test_of_many_that_begin_at_once_one_describes_the_job(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("os.getpid", threading.get_native_id)  # as good as processes, and quicker
    folder, errors = JobFolder(tmp_path / "out"), []
    gate = threading.Barrier(8)

    def begin(seed: int) -> None:
        gate.wait()
        try:
            folder.begin(JOB | {"seed": seed}, [NAMES[seed % 3]])
        except DataError as error:
            errors.append(str(error))

    threads = [threading.Thread(target=begin, args=(k % 2,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(errors) == 4
    assert all("seed was" in error for error in errors)
    assert folder.read_job()["seed"] in (0, 1)
    assert sorted(path.name for path in folder.path.iterdir()) == ["_job.json", "_records"]


def test_a_file_system_without_links_will_do(tmp_path: Path, monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    assert folder.read_job() == JOB


def test_temporaries_of_the_dead_are_swept_and_those_of_the_living_stay(tmp_path: Path):
    folder = JobFolder(tmp_path / "out")
    folder.begin(JOB, NAMES)
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    alive = [f".a.{HOST}.1.tmp.parquet", f".a.elsewhere.{gone.pid}.tmp.parquet", ".strange", ".a.tmp"]
    dead = [f".a.{HOST}.{gone.pid}.tmp.parquet", f"_records/.x.y\n.{HOST}.{gone.pid}.tmp.json"]
    for name in [*alive, *dead]:
        (folder.path / name).write_text("half")
    folder.begin(JOB, NAMES)
    assert sorted(path.name for path in folder.path.rglob(".*")) == sorted(alive)


def test_the_manifest_has_everything_and_nothing_that_differs_between_runs(place: Path, robot):
    manifest = json.loads((place / "done/_manifest.json").read_text())
    assert manifest["robot fingerprint"] == robot.fingerprint
    assert list(manifest["partitions"]) == NAMES
    assert {"input", "rows", "bytes", "sha256", "counts"} == set(manifest["partitions"]["a"])
    assert manifest["totals"]["rows"] == 60
    assert manifest["totals"]["counts"]["poses"] == 60
    task = task_of(robot, place / "poses", place / "again")
    solve_here(task, ["c", "a"])
    assert finish(task.output, task.job()) == ["b"]
    assert not (place / "again/_manifest.json").exists()
    solve_here(task, ["b"])
    assert finish(task.output, task.job()) == []
    assert hashes(place / "again") == hashes(place / "done")
