"""A file of joints as a motion to play."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.files import open_joints
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot

MOST_ROWS = 1_000_000
LINE = 2000  # points of the tool's way that are drawn
FILM = 900  # pictures of an exported page


@dataclass(frozen=True, eq=False)
class Motion:
    """Joints, one row after the other.

    Attributes:
        name: of the file.
        q: (k, n) [rad or m], finite.
        skipped: rows of the file that were left out because they are not finite.
    """

    name: str
    q: Tensor
    skipped: int = 0

    def tool_path(self, robot: Robot, *, points: int = LINE) -> Tensor:
        """(p, 3) positions of the tool [m], at most so many, first and last row included."""
        return forward_kinematics(robot, self.q[thinned(len(self.q), points)])[:, :3, 3]


def thinned(count: int, most: int) -> Tensor:
    """Indices of at most so many of ``count`` rows, evenly, the first and the last included.

    Example:
        >>> thinned(10, 4).tolist(), thinned(3, 9).tolist()
        ([0, 3, 6, 9], [0, 1, 2])
    """
    return torch.linspace(0, count - 1, min(count, most)).round().long()


def read_motion(path: str | Path, robot: Robot) -> Motion:
    """Read a joint file, such as `ikgrad solve` writes.

    Args:
        path: ``.csv``, ``.npy``, ``.npz`` or ``.parquet``, see `ikgrad.files.open_joints`.
        robot: whose joints they are.

    Raises:
        DataError: not readable, of another robot, too many rows, or none that is finite.
    """
    file = open_joints(path, robot)
    if file.total > MOST_ROWS:
        raise DataError(f"{path}: has {file.total:,} rows; a page plays {MOST_ROWS:,} at most")
    q = torch.cat(list(file.chunks()))
    good = q.isfinite().all(dim=-1)
    if not bool(good.any()):
        raise DataError(f"{path}: no row has finite joints")
    return Motion(Path(path).name, q[good], int((~good).sum()))


__all__ = ["Motion", "read_motion", "thinned"]
