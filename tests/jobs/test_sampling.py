"""Folders of samples: every partition from its own stream."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from job_folders import hashes

import ikgrad as ik
from ikgrad.errors import ConfigError
from ikgrad.files import open_joints, open_poses
from ikgrad.jobs import sampling
from ikgrad.jobs.folder import JobFolder
from ikgrad.jobs.manifest import finish
from ikgrad.jobs.sampling import SampleTask


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("panda")


def sample(robot: ik.Robot, place: Path, *, backwards: bool = False, joints: bool = True, **changes: int) -> SampleTask:
    place.mkdir(exist_ok=True)
    options = dict(count=130, rows=50, seed=7) | changes
    task = SampleTask(robot, JobFolder(place / "poses"), JobFolder(place / "q") if joints else None, **options)
    names = list(task.job("poses")["partitions"])
    task.poses.begin(task.job("poses"), names, resume=True)
    if task.joints:
        task.joints.begin(task.job("joints"), names, resume=True)
    for name in reversed(names) if backwards else names:
        task(name)
    finish(task.poses, task.job("poses"))
    return task


def test_poses_belong_to_the_joints_and_these_to_the_limits(tmp_path: Path, robot):
    sample(robot, tmp_path)
    assert [path.name for path in sorted((tmp_path / "poses").glob("*.parquet"))] == [
        "part-0000000.parquet", "part-0000001.parquet", "part-0000002.parquet",
    ]  # fmt: skip
    total = 0
    for path in sorted((tmp_path / "poses").glob("*.parquet")):
        [poses] = open_poses(path).chunks()
        [q] = open_joints(tmp_path / "q" / path.name, robot).chunks()
        error = ik.pose_error(ik.forward_kinematics(robot, q), poses.T)
        assert error.abs().max() < 1e-14
        assert ((robot.q_min <= q) & (q <= robot.q_max)).all()
        total += len(q)
    assert total == 130


def test_bytes_do_not_depend_on_order_threads_or_other_outputs(tmp_path: Path, robot):
    sample(robot, tmp_path / "one")
    torch.set_num_threads(2)
    sample(robot, tmp_path / "two", backwards=True, joints=False)
    torch.set_num_threads(1)
    assert hashes(tmp_path / "one/poses") == hashes(tmp_path / "two/poses")


def rows(place: Path) -> np.ndarray:
    tables = [pq.read_table(path) for path in place.glob("*.parquet")]
    return np.concatenate([np.stack([column.to_numpy() for column in table.columns], axis=1) for table in tables])


def test_no_two_partitions_or_groups_or_seeds_share_numbers(tmp_path: Path, robot, monkeypatch):
    monkeypatch.setattr(sampling, "ROWS", 20)
    sample(robot, tmp_path / "one")
    sample(robot, tmp_path / "two", seed=8)
    both = np.concatenate([rows(tmp_path / "one/q"), rows(tmp_path / "two/q")])
    assert len(np.unique(both, axis=0)) == 260
    assert pq.read_metadata(tmp_path / "one/poses/part-0000000.parquet").num_row_groups == 3


def test_more_poses_keep_the_full_partitions(tmp_path: Path, robot):
    sample(robot, tmp_path / "few")
    sample(robot, tmp_path / "many", count=500)
    few, many = hashes(tmp_path / "few/poses"), hashes(tmp_path / "many/poses")
    assert all(few[f"part-000000{k}.parquet"] == many[f"part-000000{k}.parquet"] for k in (0, 1))


@pytest.mark.parametrize("place", ["poses", "q"])
def test_either_output_is_made_again_if_it_is_not_as_it_was(tmp_path: Path, robot, place):
    task = sample(robot, tmp_path)
    path = tmp_path / place / "part-0000001.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    record = task("part-0000001")
    assert record["fresh"]
    assert "bytes, had" in record["redone"]
    assert path.read_bytes() == whole
    assert not task("part-0000001")["fresh"]


def test_too_many_partitions_are_refused(robot):
    task = SampleTask(robot, JobFolder(Path("x")), None, 10**9, 1, 0)
    with pytest.raises(ConfigError, match="1,000,000,000 partitions are too many; --partition-rows makes them larger"):
        task.job("poses")
