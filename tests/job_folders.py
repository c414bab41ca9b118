"""Folders of partitions for tests of jobs."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.files import pose_writer
from ikgrad.jobs.folder import JobFolder
from ikgrad.jobs.solving import SolveTask
from ikgrad.jobs.task import Record, Task

SETTINGS: dict[str, Any] = dict(
    solver=ik.LevenbergMarquardt(), solutions=1, tol_pos=1e-6, tol_rot=1e-6, limits=True, mask=None, seed=0
)


def hard_poses(robot: ik.Robot, count: int, seed: int = 0) -> Tensor:
    """Reachable ones, and among them some that are far away, beyond the limits' reach, or none at all."""
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, count, seed=seed))
    T[3::17, 0, 3] += 50
    T[5::13, :3, 3] *= 1.02
    T[7::19, 1, 3] = torch.nan
    return T


def write_folder(folder: Path, parts: dict[str, Tensor]) -> Path:
    """Partitions of given poses; no rows are welcome."""
    folder.mkdir(exist_ok=True)
    for name, T in parts.items():
        path = folder / f"{name}.parquet"
        with pose_writer(path, force=True) as writer:
            writer.append(T)
    return folder


def task_of(robot: ik.Robot, poses: Path, output: Path, **settings: Any) -> SolveTask:
    return SolveTask(robot, poses, JobFolder(output), SETTINGS | settings)


def solve_here(task: SolveTask, names: Sequence[str] | None = None, **how: bool) -> dict[str, Record]:
    """The job in this process, or some partitions of it."""
    job = task.job()
    own = list(job["partitions"]) if names is None else list(names)
    task.output.begin(job, own, **how)
    return {name: task(name) for name in own}


def run_here(task: Task, names: Sequence[str], **_: int) -> Iterator[Record]:
    """An engine without processes, for tests of what is around it."""
    task.warm_up()
    return (task(name) for name in names)


def rows_by_pose(poses: Path, joints: Path) -> dict[str, str]:
    """Every answer under its question, to the bit, whatever the files and the order."""
    rows: dict[str, str] = {}
    for path in sorted(poses.glob("*.parquet")):
        questions = pq.read_table(path).to_pylist()
        answers = pq.read_table(joints / path.name).to_pylist()
        for question, answer in zip(questions, answers, strict=True):
            rows[_exact(question)] = _exact(answer)
    return rows


def _exact(row: dict[str, Any]) -> str:
    return json.dumps({name: value.hex() if isinstance(value, float) else value for name, value in row.items()})


def hashes(folder: Path) -> dict[str, str]:
    """What is in an output folder, but for the times in its records."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir()) if path.is_file()
    }


def wait_until(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")  # nobody waits for orphans
