"""Pose files.

CSV and Parquet have the columns ``x_m,y_m,z_m,qw,qx,qy,qz`` (position in metres, unit quaternion), in any order;
``.npy`` and ``.npz`` hold (N, 4, 4) matrices (in a ``.npz``: the array ``poses``, or the only one).

A bad row is no error of the file. It becomes a target that `ikgrad.solve_ik` reports as ``invalid_target``, and
``Targets.deviation`` says how far it is from a rigid transform.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.files.columns import Table
from ikgrad.files.csv_table import CsvTable
from ikgrad.files.npy_table import NpyTable, npz_names
from ikgrad.files.parquet_table import ParquetTable
from ikgrad.files.places import check_input
from ikgrad.files.writers import SUFFIXES, Writer, open_writer
from ikgrad.rotations import nearest_rotation, quat_wxyz_from_matrix

COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
CHUNK = 65_536
IN_CACHE = 4_096
QUATERNION_TOLERANCE = 1e-3  # of the norm: three printed digits are enough to be meant as a unit quaternion
ROTATION_TOLERANCE = 1e-4  # deviation up to which `solve_ik` takes a matrix as it is
SMALLEST_DETERMINANT = 1e-6  # below it, or mirrored, no rotation is the nearest in a way that could be meant


class Targets(NamedTuple):
    """A chunk of poses."""

    T: Tensor  # (k, 4, 4) float64 [m]; NaN where a quaternion is no unit quaternion
    deviation: Tensor  # (k,) max |R^T R - I| as in the file; NaN if not finite; inf if mirrored or not 0 0 0 1 below


@dataclass(frozen=True)
class PoseFile:
    """A file of poses, opened by `open_poses`.

    Attributes:
        path: the file.
        table: its numbers.
        quaternions: rows of seven numbers instead of matrices.
        repair: project what is no rotation.
    """

    path: Path
    table: Table
    quaternions: bool
    repair: bool = False

    @property
    def total(self) -> int:
        """Number of poses."""
        return self.table.total

    def chunks(self, rows: int = CHUNK) -> Iterator[Targets]:
        """The poses, ``rows`` at a time.

        Raises:
            DataError: text that is no number, a row that is too short or long, a damaged file.
        """
        for array in self.table.chunks(rows):
            given = torch.from_numpy(array)
            yield from_quaternions(given, self.repair) if self.quaternions else from_matrices(given, self.repair)


def open_poses(path: str | Path, *, repair: bool = False, kind: str | None = None) -> PoseFile:
    r"""Open a file of poses; what can be checked without reading it all is checked here.

    Args:
        path: ``.csv``, ``.npy``, ``.npz`` or ``.parquet``.
        repair: replace each matrix that is no rotation by the nearest rotation, and normalise each quaternion.
        kind: read it as a file with this suffix; default: its own.

    Raises:
        DataError: no such file, a wrong column or shape, no rows, not readable.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp(), "poses.csv")
        >>> _ = path.write_text("x_m,y_m,z_m,qw,qx,qy,qz\n0.5,0,0.3,0,1,0,0\n")
        >>> [targets.T[0, :3, 3].tolist() for targets in open_poses(path).chunks()]
        [[0.5, 0.0, 0.3]]
    """
    path = Path(path)
    kind = kind or path.suffix.lower()
    check_input(path, SUFFIXES, kind)
    if kind == ".csv":
        return PoseFile(path, CsvTable(path, COLUMNS), True, repair)
    if kind == ".parquet":
        return PoseFile(path, ParquetTable(path, COLUMNS), True, repair)
    return PoseFile(path, NpyTable(path, (4, 4), _member(path) if kind == ".npz" else None), False, repair)


def _member(path: Path) -> str:
    names = npz_names(path)
    if "poses" not in names and len(names) != 1:
        raise DataError(f"{path}: expected an array 'poses', or only one; it has {', '.join(names) or 'none'}")
    return "poses" if "poses" in names else names[0]


def from_quaternions(rows: Tensor, repair: bool = False) -> Targets:
    """Poses of rows x, y, z, qw, qx, qy, qz; quaternions within 1e-3 of unit length are normalised.

    Args:
        rows: (k, 7)
        repair: normalise any quaternion except zero.

    Example:
        >>> targets = from_quaternions(torch.tensor([[0, 0, 1, 2.0, 0, 0, 0]]))
        >>> targets.T.isfinite().all().item(), targets.deviation
        (False, tensor([15.]))
    """
    norm = rows[:, 3:].norm(dim=-1)
    finite = (0 * rows).sum(dim=-1) == 0  # 0 times infinity is NaN
    near = (norm - 1).abs() <= QUATERNION_TOLERANCE
    usable = finite & ((norm > QUATERNION_TOLERANCE) if repair else near)
    T = _pose_matrices(rows, norm)
    if not usable.all():
        T[~usable] = torch.nan
    deviation = torch.where(near, 0.0, (norm**4 - 1).abs())  # length s makes the matrix s^2 R
    return Targets(T, torch.where(finite, deviation, torch.nan))


def _pose_matrices(rows: Tensor, norm: Tensor) -> Tensor:
    """What `matrix_from_quat_wxyz` gives, written in place, as many rows at a time as fit the cache: twice as fast."""
    poses = rows.new_empty(len(rows), 4, 4)
    for row, s, T in zip(rows.split(IN_CACHE), norm.split(IN_CACHE), poses.split(IN_CACHE), strict=True):
        w, x, y, z = (row[:, 3:] / s[:, None]).T.contiguous()
        T[:, 0, 0], T[:, 0, 1], T[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        T[:, 1, 0], T[:, 1, 1], T[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        T[:, 2, 0], T[:, 2, 1], T[:, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        T[:, :3, 3] = row[:, :3]
        T[:, 3] = torch.tensor([0.0, 0, 0, 1]).to(T)
    return poses


def from_matrices(T: Tensor, repair: bool = False) -> Targets:
    """Matrices with their deviation; with ``repair`` those that are no rotation become the nearest one.

    Args:
        T: (k, 4, 4)
        repair: see above. Mirrored and singular matrices, and a wrong last row, stay as they are.

    Example:
        >>> T = torch.eye(4)[None] * torch.tensor([1.1, 1.1, 1.1, 1.0])
        >>> from_matrices(T).deviation, from_matrices(T, repair=True).T[0, 0, 0]
        (tensor([0.2100]), tensor(1.))
    """
    finite = T.isfinite().all(dim=-1).all(dim=-1)
    safe = torch.where(finite[:, None, None], T, torch.eye(4).to(T))
    R = safe[:, :3, :3]
    det = torch.linalg.det(R)
    skew = (R.mT @ R - torch.eye(3).to(T)).abs().amax(dim=(-2, -1))
    bottom = (safe[:, 3] - torch.tensor([0.0, 0, 0, 1]).to(T)).abs().amax(dim=-1) > ROTATION_TOLERANCE
    deviation = torch.where(bottom | (det < 0), torch.inf, skew)
    if repair:
        wrong = finite & deviation.isfinite() & (deviation > ROTATION_TOLERANCE) & (det > SMALLEST_DETERMINANT)
        T = T.clone()
        T[wrong, :3, :3] = nearest_rotation(R[wrong])
    return Targets(T, torch.where(finite, deviation, torch.nan))


class PoseWriter:
    """Takes chunks of poses; made by `pose_writer`."""

    def __init__(self, writer: Writer, matrices: bool):
        self._writer, self._matrices = writer, matrices

    def append(self, T: Tensor) -> None:
        """Add poses (k, 4, 4)."""
        if self._matrices:
            self._writer.append({"poses": T.numpy()})
        else:
            self._writer.append(pose_columns(T))


def pose_columns(T: Tensor) -> dict[str, np.ndarray]:
    """(k, 4, 4) poses as the columns of a CSV or Parquet file, each (k,)."""
    quat_wxyz = torch.cat([quat_wxyz_from_matrix(part) for part in T[:, :3, :3].split(IN_CACHE)])
    values = torch.cat([T[:, :3, 3], quat_wxyz], dim=-1).numpy()
    return dict(zip(COLUMNS, values.T, strict=True))


@contextlib.contextmanager
def pose_writer(path: str | Path, *, force: bool = False) -> Iterator[PoseWriter]:
    """A file of poses that appears, whole, when the block ends well.

    Args:
        path: ``.csv``, ``.npy``, ``.npz`` or ``.parquet``.
        force: overwrite an existing file.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp(), "poses.npz")
        >>> with pose_writer(path) as writer:
        ...     writer.append(torch.eye(4, dtype=torch.float64)[None])
        >>> open_poses(path).total
        1
    """
    path = Path(path)
    with open_writer(path, force=force) as writer:
        yield PoseWriter(writer, path.suffix.lower() in {".npy", ".npz"})
