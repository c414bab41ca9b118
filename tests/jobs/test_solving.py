"""Folders of poses: an answer depends on its pose alone, and a partition's bytes on its poses alone."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest
import torch
from job_folders import hard_poses, hashes, rows_by_pose, solve_here, task_of, write_folder

import ikgrad as ik
from ikgrad.cli.main import main
from ikgrad.errors import DataError
from ikgrad.jobs import run_local, solving
from ikgrad.jobs.manifest import finish, summary_of


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("panda")


@pytest.fixture(scope="module")
def poses(robot) -> torch.Tensor:
    return hard_poses(robot, 120)


def test_an_answer_is_that_of_solve_ik(tmp_path: Path, robot, poses):
    folder = write_folder(tmp_path / "poses", {"a": poses[:50], "b": poses[50:]})
    records = solve_here(task_of(robot, folder, tmp_path / "joints"))
    T = torch.cat([chunk.T for name in "ab" for chunk in ik.files.open_poses(folder / f"{name}.parquet").chunks()])
    expected = ik.solve_ik(robot, T)
    tables = [pq.read_table(tmp_path / "joints" / f"{name}.parquet").to_pydict() for name in "ab"]
    for k, joint in enumerate(robot.joint_names):
        assert tables[0][joint] + tables[1][joint] == expected.q[:, k].tolist()
    assert tables[0]["reason"] + tables[1]["reason"] == expected.reason.tolist()
    assert tables[0]["steps"] + tables[1]["steps"] == expected.steps.tolist()
    assert len(set(expected.reason)) >= 3
    summary = summary_of(records.values())
    assert summary.poses == 120
    assert summary.solved == int(expected.success.sum())
    assert {"converged": summary.solved, **summary.failed} == expected.counts()


def test_rows_do_not_depend_on_order_or_partitions_or_threads(tmp_path: Path, robot, poses):
    order = torch.randperm(120, generator=torch.Generator().manual_seed(1))
    layouts = {
        "one": {"all": poses},
        "permuted": {"all": poses[order]},
        "split": {f"p{k}": part for k, part in enumerate(poses[order].split([1, 7, 64, 0, 48]))},
        "threads": {"x": poses[:60], "y": poses[60:]},
    }
    found = {}
    for name, parts in layouts.items():
        folder, output = write_folder(tmp_path / name, parts), tmp_path / f"{name}-out"
        torch.set_num_threads(2 if name == "threads" else 1)
        solve_here(task_of(robot, folder, output))
        found[name] = rows_by_pose(folder, output)
    torch.set_num_threads(1)
    assert len(found["one"]) > 100
    assert all(rows == found["one"] for rows in found.values())


def test_groups_of_rows_do_not_change_answers(tmp_path: Path, robot, poses, monkeypatch):
    folder = write_folder(tmp_path / "poses", {"a": poses})
    solve_here(task_of(robot, folder, tmp_path / "whole"))
    monkeypatch.setattr(solving, "ROWS", 50)
    solve_here(task_of(robot, folder, tmp_path / "groups"))
    assert pq.read_metadata(tmp_path / "groups/a.parquet").num_row_groups == 3
    assert rows_by_pose(folder, tmp_path / "whole") == rows_by_pose(folder, tmp_path / "groups")


def test_partitions_have_the_same_bytes_from_any_number_of_workers(tmp_path: Path, robot, poses):
    folder = write_folder(tmp_path / "poses", {f"p{k}": part for k, part in enumerate(poses.split(30))})
    task = task_of(robot, folder, tmp_path / "here")
    solve_here(task)
    assert finish(task.output, task.job()) == []
    found = [hashes(tmp_path / "here")]
    for workers, threads in [(2, 1), (1, 2)]:
        task = task_of(robot, folder, tmp_path / f"{workers}-{threads}")
        job = task.job()
        names = list(job["partitions"])
        task.output.begin(job, names)
        records = list(run_local(task, names, workers=workers, threads=threads))
        assert sorted(record["name"] for record in records) == names
        assert all(record["fresh"] for record in records)
        assert finish(task.output, job) == []
        found.append(hashes(task.output.path))
    assert set(found[0]) == {"_job.json", "_manifest.json", *(f"p{k}.parquet" for k in range(4))}
    assert found[0] == found[1] == found[2]


def test_no_rows_give_no_rows_in_the_same_columns(tmp_path: Path, robot, poses):
    folder = write_folder(tmp_path / "poses", {"empty": poses[:0], "some": poses[:5]})
    records = solve_here(task_of(robot, folder, tmp_path / "joints"))
    empty, some = (pq.read_table(tmp_path / f"joints/{name}.parquet") for name in ("empty", "some"))
    assert empty.num_rows == records["empty"]["rows"] == 0
    assert empty.schema == some.schema


def test_several_solutions_are_numbered_in_their_partition(tmp_path: Path, robot, poses, monkeypatch):
    monkeypatch.setattr(solving, "FEWER", 12)
    folder = write_folder(tmp_path / "poses", {"a": poses[:10]})
    records = solve_here(task_of(robot, folder, tmp_path / "joints", solutions=3))
    table = pq.read_table(tmp_path / "joints/a.parquet")
    assert table["row"].to_pylist() == [k // 3 for k in range(30)]
    assert table["solution"].to_pylist() == [k % 3 for k in range(30)]
    assert (records["a"]["rows"], records["a"]["counts"]["poses"]) == (30, 10)


def test_columns_are_those_of_a_single_file(tmp_path: Path, robot, poses, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = write_folder(tmp_path / "poses", {"a": poses[:20]})
    solve_here(task_of(robot, folder, tmp_path / "joints"))
    assert main(["solve", "--robot", "panda", "poses/a.parquet", "-o", "single.parquet"]) == 0
    assert (tmp_path / "single.parquet").read_bytes() == (tmp_path / "joints/a.parquet").read_bytes()


def test_an_input_that_changes_meanwhile_is_refused(tmp_path: Path, robot, poses):
    folder = write_folder(tmp_path / "poses", {"a": poses[:20]})
    task = task_of(robot, folder, tmp_path / "joints")
    task.output.begin(task.job(), ["a"])
    write_folder(folder, {"a": poses[20:40]})
    with pytest.raises(DataError, match=r"a\.parquet: changed since the job began: footer of partition 'a' was"):
        task("a")
    assert not (tmp_path / "joints/a.parquet").exists()


def test_a_machine_of_another_kind_is_refused(tmp_path: Path, robot, poses, monkeypatch):
    folder = write_folder(tmp_path / "poses", {"a": poses[:20]})
    task = task_of(robot, folder, tmp_path / "joints")
    task.output.begin(task.job(), ["a"])
    monkeypatch.setattr("ikgrad.jobs.machine._processor", lambda: "abacus")
    with pytest.raises(ik.errors.ConfigError, match=r"would give other bits.*processor was .*, is abacus"):
        task.warm_up()


def test_a_broken_page_is_an_error_that_names_the_file(tmp_path: Path, robot, poses):
    folder = write_folder(tmp_path / "poses", {"a": poses})
    path = folder / "a.parquet"
    whole = bytearray(path.read_bytes())
    whole[4:60] = b"\xff" * 56
    path.write_bytes(whole)
    task = task_of(robot, folder, tmp_path / "joints")
    with pytest.raises(DataError, match=r"a\.parquet: is damaged"):
        solve_here(task)
    assert sorted(path.name for path in (tmp_path / "joints").iterdir()) == ["_job.json", "_records"]
