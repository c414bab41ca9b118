"""What is written of a solution, and what is said of many."""

from __future__ import annotations

import dataclasses
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from torch import Tensor

from ikgrad.files.joints import REASONS
from ikgrad.files.poses import ROTATION_TOLERANCE
from ikgrad.files.writers import Columns
from ikgrad.solvers.solution import IKSolution, Reason

HIDDEN = "deviation"  # kept for the summary, no column of the output


def answer_columns(solution: IKSolution, deviation: Tensor, *, first: int = 0) -> Columns:
    """A row for each solution, in the columns of a joint file, and `HIDDEN`.

    Args:
        solution: for k poses (k,), or (k, solutions).
        deviation: (k,) of `ikgrad.files.poses.Targets`.
        first: row of the first pose in its file.
    """
    count = solution.success.shape[-1] if solution.success.ndim == 2 else 1
    columns: Columns = {}
    if count > 1:
        columns["row"] = np.repeat(np.arange(first, first + len(deviation)), count)
        columns["solution"] = np.tile(np.arange(count), len(deviation))
    columns["q"] = solution.q.reshape(-1, solution.q.shape[-1]).numpy()
    columns["position_error_m"] = solution.position_error.reshape(-1).numpy()
    columns["rotation_error_rad"] = solution.rotation_error.reshape(-1).numpy()
    columns["success"] = solution.success.reshape(-1).numpy()
    columns["reason"] = solution.reason_code.reshape(-1).numpy()
    columns["steps"] = solution.steps.reshape(-1).numpy()
    columns[HIDDEN] = np.repeat(deviation.numpy(), count)
    return columns


@dataclass
class Summary:
    """Counts over all rows. With several solutions a pose counts as solved if it has at least one."""

    solutions: int
    poses: int = 0
    solved: int = 0
    found: int = 0  # solutions, over all poses
    failed: Counter[str] = field(default_factory=Counter)
    worst_position: float = 0.0  # among the solved [m]
    worst_rotation: float = 0.0  # [rad]
    not_finite: int = 0
    not_rigid: int = 0  # invalid: finite, but no rigid transform
    repaired: int = 0
    worst_deviation: float = 0.0  # max |R^T R - I| among those two
    mirrored: int = 0  # of the not rigid: mirrored, or the last row is not 0 0 0 1

    def add(self, columns: Columns, deviation: np.ndarray) -> None:
        """Count the rows of `answer_columns`."""
        success, reason = columns["success"], columns["reason"]
        self.found += int(success.sum())
        solved = np.logical_or.reduce(success.reshape(-1, self.solutions), axis=1)
        self.poses += len(solved)
        self.solved += int(solved.sum())
        first_reason = reason.reshape(-1, self.solutions)[:, 0]
        numbers = np.bincount(first_reason[~solved], minlength=len(REASONS)).tolist()
        self.failed.update({name: number for name, number in zip(REASONS, numbers, strict=True) if number})
        if success.any():
            self.worst_position = max(self.worst_position, float(columns["position_error_m"][success].max()))
            self.worst_rotation = max(self.worst_rotation, float(columns["rotation_error_rad"][success].max()))
        self._add_deviation(deviation[:: self.solutions], first_reason == Reason.invalid_target)

    def _add_deviation(self, deviation: np.ndarray, invalid: np.ndarray) -> None:
        off = np.nan_to_num(deviation, nan=0.0) > ROTATION_TOLERANCE
        self.not_finite += int(np.isnan(deviation).sum())
        self.not_rigid += int((off & invalid).sum())
        self.mirrored += int(np.isinf(deviation).sum())
        self.repaired += int((off & ~invalid).sum())
        measured = deviation[off & np.isfinite(deviation)]
        self.worst_deviation = max([self.worst_deviation, *measured.tolist()])

    def counts(self) -> dict[str, Any]:
        """As plain JSON."""
        return dataclasses.asdict(self) | {"failed": dict(sorted(self.failed.items()))}

    def include(self, counts: dict[str, Any]) -> None:
        """Add what `counts` of another summary said."""
        for name, value in counts.items():
            before = getattr(self, name)
            if name == "failed":
                before.update(value)
            elif name.startswith("worst"):
                setattr(self, name, max(before, value))
            elif name != "solutions":
                setattr(self, name, before + value)
