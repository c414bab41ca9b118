"""Inverse kinematics of folders of poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.joints import REASONS
from ikgrad.files.parquet_table import ParquetTable, pyarrow_parquet
from ikgrad.files.poses import COLUMNS, PoseFile, Targets, from_quaternions
from ikgrad.files.writers import Columns
from ikgrad.jobs.answers import HIDDEN, Summary, answer_columns
from ikgrad.jobs.folder import Job, JobFolder
from ikgrad.jobs.machine import check_machine, machine
from ikgrad.jobs.partitions import changed_partitions, list_names, look_at
from ikgrad.jobs.task import Record
from ikgrad.jobs.writing import Clock, partition_writer, peak_memory
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot
from ikgrad.solvers.closed_form import Puma560ClosedForm
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.solve import solve_ik

ROWS = 65_536  # answers in a row group, which is solved, written and kept in memory at a time
FEWER = 8_192  # by methods in torch, which need tens of kilobytes for each


@dataclass(frozen=True)
class SolveTask:
    """Poses in, joints out.

    Attributes:
        robot: the robot.
        poses: folder of the input partitions.
        output: where the joints go; its job was begun.
        settings: keyword arguments of `ikgrad.solve_ik`.
        repair: see `ikgrad.files.open_poses`.
    """

    robot: Robot
    poses: Path
    output: JobFolder
    settings: Mapping[str, Any]
    repair: bool = False

    def job(self) -> Job:
        """What the output belongs to.

        Raises:
            DataError: an input cannot be used.
        """
        settings = {name: _plain(value) for name, value in self.settings.items()}
        names = list_names(self.poses)
        return {
            "job": "solve",
            **machine(),
            "robot": self.robot.name,
            "robot fingerprint": self.robot.fingerprint,
            **settings,
            "repair": self.repair,
            "rows of a group": self._rows,
            "partitions": {name: look_at(self._input(name), COLUMNS) for name in names},
        }

    @property
    def _rows(self) -> int:
        solver, solutions = self.settings["solver"], self.settings["solutions"]
        lean = solutions == 1 and isinstance(solver, LevenbergMarquardt | Puma560ClosedForm)
        return max(1, (ROWS if lean else FEWER) // solutions)

    def _input(self, name: str) -> Path:
        return JobFolder(self.poses).partition(name)

    def warm_up(self) -> None:
        """Load the kernels and the robot's tables."""
        check_machine(self.output.job())
        pyarrow_parquet(self.output.path)
        low, high = self.robot.sampling_range
        q = (low + high) / 2
        solve_ik(self.robot, forward_kinematics(self.robot, q), q0=q, **self.settings)

    def __call__(self, name: str) -> Record:
        """Solve a partition, or verify it."""
        found = self.output.check(name)
        if found.record is not None:
            return found.record | {"fresh": False}
        clock, summary = Clock(), Summary(self.settings["solutions"])
        with partition_writer(self.output.partition(name), clock, {"reason": REASONS}) as writer:
            first = 0
            for targets in clock.each("read", self._targets(name)):
                with clock("solve"):
                    solution = solve_ik(self.robot, targets.T, **self.settings)
                columns = answer_columns(solution, targets.deviation, first=first)
                summary.add(columns, columns.pop(HIDDEN))
                writer.append(self._flat(columns))
                first += len(targets.T)
        record = {
            "name": name,
            "rows": writer.rows,
            "bytes": writer.bytes,
            "sha256": writer.sha256,
            "counts": summary.counts(),
            "seconds": clock.report(),
            "peak_memory": peak_memory(),
        }
        self.output.keep(record)
        return record | {"fresh": True} | ({"redone": found.wrong} if found.wrong else {})

    def _targets(self, name: str) -> Iterator[Targets]:
        """The poses, a row group at a time; one empty group if there are none."""
        path = self._input(name)
        expected = self.output.job()["partitions"][name]
        changed = changed_partitions({name: expected}, {name: look_at(path, COLUMNS)})
        if changed:
            raise DataError(f"{path}: changed since the job began: {'; '.join(changed)}")
        if not expected["rows"]:
            import torch

            yield from_quaternions(torch.empty(0, len(COLUMNS), dtype=torch.float64))
        yield from PoseFile(path, ParquetTable(path, COLUMNS, empty=True), True, self.repair).chunks(self._rows)

    def _flat(self, columns: Columns) -> Columns:
        """A column for each joint."""
        q = np.ascontiguousarray(columns["q"].T)
        flat: Columns = {}
        for name, value in columns.items():
            flat.update(zip(self.robot.joint_names, q, strict=True) if name == "q" else [(name, value)])
        return flat


def _plain(value: Any) -> Any:
    return value if isinstance(value, int | float) else repr(value)
