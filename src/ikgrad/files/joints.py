"""Joint files: one row of joint values per pose [rad, or m for slides], under the joints' names.

``.csv`` and ``.parquet`` have a column per joint; ``.npz`` has ``q`` (N, n) and ``joint_names``; ``.npy`` has (N, n) in
the robot's order. Files that `joint_writer` made carry results too: see `RESULTS`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.files.columns import Table, pick
from ikgrad.files.csv_table import CsvTable
from ikgrad.files.npy_table import NpyTable, npz_names
from ikgrad.files.parquet_table import ParquetTable
from ikgrad.files.places import check_input
from ikgrad.files.writers import SUFFIXES, Columns, Writer, open_writer
from ikgrad.robot import Robot
from ikgrad.solvers.solution import Reason

PLACES = ("row", "solution")  # row: index of the pose in its file, from 0
RESULTS = ("position_error_m", "rotation_error_rad", "success", "reason", "steps")
REASONS = tuple(reason.name for reason in Reason)  # what the numbers of a column ``reason`` stand for
OUT_SUFFIXES = (".csv", ".npz", ".parquet")
CHUNK = 65_536


@dataclass(frozen=True)
class JointFile:
    """A file of joint values, opened by `open_joints`."""

    path: Path
    table: Table
    order: tuple[int, ...]  # column of the table for each joint of the robot

    @property
    def total(self) -> int:
        """Number of rows."""
        return self.table.total

    def chunks(self, rows: int = CHUNK) -> Iterator[Tensor]:
        """Joint values (k, n) float64 in the robot's order, ``rows`` at a time.

        Raises:
            DataError: text that is no number, a row that is too short or long, a damaged file.
        """
        for array in self.table.chunks(rows):
            yield torch.from_numpy(array[:, self.order])


def open_joints(path: str | Path, robot: Robot, *, kind: str | None = None) -> JointFile:
    """Open a file of joint values for a robot.

    Args:
        path: ``.csv``, ``.npy``, ``.npz`` or ``.parquet``.
        robot: whose joint names must be there; the columns of `RESULTS` may be there too.
        kind: read it as a file with this suffix; default: its own.

    Raises:
        DataError: no such file, a wrong column or shape, no rows, not readable.

    Example:
        >>> import ikgrad as ik, tempfile
        >>> robot = ik.load_robot("arm4")
        >>> path = Path(tempfile.mkdtemp(), "q.npy")
        >>> np.save(path, np.zeros((3, 4)))
        >>> next(open_joints(path, robot).chunks()).shape
        torch.Size([3, 4])
    """
    path = Path(path)
    kind = kind or path.suffix.lower()
    check_input(path, SUFFIXES, kind)
    names, also = robot.joint_names, {*PLACES, *RESULTS} - set(robot.joint_names)
    straight = tuple(range(robot.dof))
    if kind == ".csv":
        return JointFile(path, CsvTable(path, names, also), straight)
    if kind == ".parquet":
        return JointFile(path, ParquetTable(path, names, also), straight)
    if kind == ".npy":
        return JointFile(path, NpyTable(path, (robot.dof,)), straight)
    return _open_npz(path, robot)


def _open_npz(path: Path, robot: Robot) -> JointFile:
    missing = [name for name in ("q", "joint_names") if name not in npz_names(path)]
    if missing:
        raise DataError(f"{path}: expected the arrays 'q' and 'joint_names', '{missing[0]}' is missing")
    try:
        with np.load(path, allow_pickle=False) as archive:
            found = [str(name) for name in np.atleast_1d(archive["joint_names"])]
    except (ValueError, OSError) as error:
        raise DataError(f"{path}, array 'joint_names': cannot be read: {error}") from error
    order = pick(f"{path}, array 'joint_names'", found, robot.joint_names)
    return JointFile(path, NpyTable(path, (len(found),), "q"), tuple(order))


class JointWriter:
    """Takes chunks of joints and results; made by `joint_writer`."""

    def __init__(self, writer: Writer, joint_names: tuple[str, ...], matrix: bool):
        self._writer, self._names, self._matrix = writer, joint_names, matrix

    def append(self, columns: Columns) -> None:
        """Add rows: ``q`` (k, n) and any of `PLACES` and `RESULTS`, each (k,), in the order of the file.

        ``reason`` is a word, or a number of `ikgrad.solvers.solution.Reason`.
        """
        if self._matrix:
            self._writer.append(columns)
            return
        flat: Columns = {}
        for name, value in columns.items():
            flat.update(zip(self._names, value.T, strict=True) if name == "q" else [(name, value)])
        self._writer.append(flat)


@contextlib.contextmanager
def joint_writer(
    path: str | Path, robot: Robot, *, force: bool = False, folder: Path | None = None
) -> Iterator[JointWriter]:
    """A file of joint values that appears, whole, when the block ends well.

    Args:
        path: ``.csv``, ``.npz`` or ``.parquet``.
        robot: gives the joint names.
        force: overwrite an existing file.
        folder: where temporary files live; default: beside ``path``.

    Example:
        >>> import ikgrad as ik, tempfile
        >>> robot = ik.load_robot("arm4")
        >>> path = Path(tempfile.mkdtemp(), "q.csv")
        >>> with joint_writer(path, robot) as writer:
        ...     writer.append({"q": np.zeros((1, 4))})
        >>> path.read_text().splitlines()[1]
        '0.0,0.0,0.0,0.0'
    """
    path = Path(path)
    matrix = path.suffix.lower() == ".npz"
    check_joint_names(path, robot)
    names = {"joint_names": np.array(robot.joint_names)}
    with open_writer(path, force=force, folder=folder, constants=names, words={"reason": REASONS}) as writer:
        yield JointWriter(writer, robot.joint_names, matrix)


def check_joint_names(path: Path, robot: Robot, *, advice: str = "write a .npz file instead") -> None:
    """Refuse, for tables with one column per joint, joints that are named like a column of results."""
    both = set(robot.joint_names) & {*PLACES, *RESULTS}
    if both and path.suffix.lower() != ".npz":
        raise DataError(f"{path}: joint '{min(both)}' is named like a column of results; {advice}")
