"""A finished map: one row a cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from ikgrad.files.writers import Columns, open_writer
from ikgrad.robot import Robot

SUFFIXES = (".parquet", ".csv", ".npz")
_ROWS = 65_536  # of one piece of the file


@dataclass(frozen=True, eq=False)
class WorkspaceMap:
    """Which poses a robot reaches, cell by cell. Made by `ikgrad.reachability`.

    Attributes:
        robot: the robot.
        cell: edge of a cell [m].
        orientations: (O, 3, 3) rotations of the tip that were tried in every cell.
        mask: six zeros or ones, which errors counted.
        centres: (C, 3) of the cells [m], all whose centre the tip could be at by the bounds alone.
        share: (C,) share of the orientations that are reached, with joints at hand that `forward_kinematics` confirms.
        unreachable: (C,) share that is out of reach for certain. What is left, 1 - share - unreachable, was
            searched without a find.
        condition: (C,) smallest condition number among the answers, of the Jacobian [linear; angular] with lengths
            divided by `Robot.typical_length`; infinite where nothing is reached.
        manipulability: (C,) largest sqrt(det J J^T) of that Jacobian, without unit (Yoshikawa 1985); 0 likewise.
        q: (C, n) joints with the smallest condition number; NaN where nothing is reached.
        orientation: (C,) int64, the orientation that they reach; -1 likewise.
        solutions_mean: (C,) different solutions of an orientation, on average over those reached, 0 where there are
            none; or None if they were not counted.
        solutions_most: (C,) int64, the most of one orientation; or None.
    """

    robot: Robot
    cell: float
    orientations: Tensor
    mask: tuple[float, ...]
    centres: Tensor
    share: Tensor
    unreachable: Tensor
    condition: Tensor
    manipulability: Tensor
    q: Tensor
    orientation: Tensor
    solutions_mean: Tensor | None = None
    solutions_most: Tensor | None = None

    def __repr__(self) -> str:
        return (
            f"WorkspaceMap({self.robot.name!r}, {len(self.centres):,} cells of {self.cell:g} m, "
            f"{len(self.orientations)} orientations, {self.volume:.3g} m^3 reached)"
        )

    @property
    def poses(self) -> int:
        """Cells times orientations."""
        return len(self.centres) * len(self.orientations)

    @property
    def reached(self) -> int:
        """Poses reached."""
        return round(float(self.share.sum()) * len(self.orientations))

    @property
    def proven_unreachable(self) -> int:
        """Poses out of reach for certain."""
        return round(float(self.unreachable.sum()) * len(self.orientations))

    @property
    def volume(self) -> float:
        """Volume of the cells that are reached in at least one orientation [m^3]."""
        return float((self.share > 0).sum()) * self.cell**3

    @property
    def dexterous_volume(self) -> float:
        """Volume of the cells that are reached in all orientations [m^3]."""
        return float((self.share == 1).sum()) * self.cell**3

    def columns(self) -> Columns:
        """The table that `save` writes: a column a quantity, the joints one by one under ``best_`` and their names."""
        columns: Columns = dict(zip(("x_m", "y_m", "z_m"), self.centres.numpy().T, strict=True))
        for name in ("share", "unreachable", "condition", "manipulability", "solutions_mean", "solutions_most"):
            value = getattr(self, name)
            if value is not None:
                columns[name] = value.numpy()
        columns["best_orientation"] = self.orientation.numpy()
        columns.update({f"best_{name}": q for name, q in zip(self.robot.joint_names, self.q.numpy().T, strict=True)})
        return columns

    def save(self, path: str | Path, *, force: bool = False, folder: Path | None = None) -> Path:
        """Write the table in one move.

        Args:
            path: ``.parquet``, ``.csv`` or ``.npz`` (which holds the ``orientations`` too).
            force: overwrite an existing file.
            folder: where temporary files live; default: beside ``path``.

        Raises:
            DataError: another suffix, the file exists and ``force`` is off, or it cannot be written.
        """
        path, columns = Path(path), self.columns()
        constants = {"orientations": self.orientations.numpy(), "cell": np.array(self.cell)}
        with open_writer(path, force=force, folder=folder, constants=constants) as writer:
            for first in range(0, len(self.centres), _ROWS):
                writer.append({name: column[first : first + _ROWS] for name, column in columns.items()})
        return path
