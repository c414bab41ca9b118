"""Folders of reachable poses, any number of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from ikgrad.data.configurations import sample_configurations
from ikgrad.errors import ConfigError
from ikgrad.files.parquet_table import pyarrow_parquet
from ikgrad.files.poses import pose_columns
from ikgrad.jobs.folder import Job, JobFolder
from ikgrad.jobs.machine import check_machine, machine
from ikgrad.jobs.task import Record
from ikgrad.jobs.writing import Clock, partition_writer, peak_memory
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot

ROWS = 65_536  # of a row group
DIGITS = 7  # of a partition's number, so that names sort as numbers do


@dataclass(frozen=True)
class SampleTask:
    """Random configurations inside the limits, and their poses.

    The configurations of a row group come from a generator of their own, keyed by the seed, the partition's number
    and the group's; so a partition does not depend on who makes it, and no more than a group is in memory.

    Attributes:
        robot: the robot.
        poses: where the poses go; its job was begun.
        joints: where the configurations go, if they are wanted; likewise.
        count: poses in all.
        rows: poses of a partition, fewer in the last.
        seed: of the random numbers.
    """

    robot: Robot
    poses: JobFolder
    joints: JobFolder | None
    count: int
    rows: int
    seed: int

    def job(self, holds: str) -> Job:
        """What an output belongs to.

        Args:
            holds: ``poses`` or ``joints``.
        """
        number = -(-self.count // self.rows)
        if number > 10**DIGITS:
            raise ConfigError(f"{number:,} partitions are too many; --partition-rows makes them larger")
        sizes = {f"part-{k:0{DIGITS}d}": min(self.rows, self.count - k * self.rows) for k in range(number)}
        return {
            "job": f"sample {holds}",
            **machine(),
            "robot": self.robot.name,
            "robot fingerprint": self.robot.fingerprint,
            "count": self.count,
            "rows of a partition": self.rows,
            "seed": self.seed,
            "rows of a group": ROWS,
            "partitions": {name: {"rows": size} for name, size in sizes.items()},
        }

    def warm_up(self) -> None:
        """Load the kernels and the robot's tables."""
        check_machine(self.poses.job())
        pyarrow_parquet(self.poses.path)
        forward_kinematics(self.robot, sample_configurations(self.robot, 1, seed=0))

    def __call__(self, name: str) -> Record:
        """Make a partition, or verify it."""
        places = [self.poses] if self.joints is None else [self.poses, self.joints]
        found = [place.check(name) for place in places]
        if found[0].record is not None and all(look.record is not None for look in found):
            return found[0].record | {"fresh": False}
        clock = Clock()
        with ExitStack() as stack:
            writers = [stack.enter_context(partition_writer(place.partition(name), clock)) for place in places]
            for q in self._configurations(name):
                with clock("solve"):
                    columns = pose_columns(forward_kinematics(self.robot, q))
                writers[0].append(columns)
                if self.joints is not None:
                    q_columns = np.ascontiguousarray(q.numpy().T)
                    writers[1].append(dict(zip(self.robot.joint_names, q_columns, strict=True)))
        records: list[Record] = [
            {"name": name, "rows": writer.rows, "bytes": writer.bytes, "sha256": writer.sha256} for writer in writers
        ]
        costs = {"seconds": clock.report(), "peak_memory": peak_memory()}
        for place, record in zip(places, records, strict=True):
            place.keep(record | costs)
        wrong = [look.wrong for look in found if look.wrong]
        return records[0] | costs | {"fresh": True} | ({"redone": wrong[0]} if wrong else {})

    def _configurations(self, name: str) -> Iterator[Tensor]:
        number = int(name.rpartition("-")[2])
        rows = min(self.rows, self.count - number * self.rows)
        for group, first in enumerate(range(0, rows, ROWS)):
            seed = int(np.random.SeedSequence([self.seed, number, group]).generate_state(1, np.uint64)[0]) >> 1
            yield sample_configurations(self.robot, min(ROWS, rows - first), seed=seed)
