"""What `ikgrad.optimize_trajectory` returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import PlanningError
from ikgrad.trajectory import Trajectory


class PlanReason(IntEnum):
    """Why a row ended as it did."""

    converged = 0
    start_collides = 1  # at the start a link is nearer to an obstacle than the margin: nothing can keep it
    goal_collides = 2
    no_convergence = 3  # no trajectory found; there may be one


_NAMES = np.array([reason.name for reason in PlanReason])


@dataclass(frozen=True, eq=False)
class OptimizedTrajectory:
    """Trajectories for a batch of starts and goals. Failure is data: every row has a finite trajectory.

    Attributes:
        trajectory: (...) `ikgrad.Trajectory`, of the dtype and on the device of ``q_start``; the best that was found
            where the row failed, the straight line where an end collides.
        success: (...) bool, proven: at all times the margin and the joint limits are kept. Limits on speed and
            the like are kept by every row.
        reason_code: (...) int8, see `PlanReason`.
        clearance: (...) the smallest distance between a link and an obstacle that was met on the way [m], negative
            inside an obstacle. Sampled; where ``success``, the margin is proven for all times.
        steps: (...) int64, steps of all descents of the row.
    """

    trajectory: Trajectory
    success: Tensor
    reason_code: Tensor
    clearance: Tensor
    steps: Tensor

    @property
    def reason(self) -> np.ndarray:
        """(...) array of str: the names of `PlanReason`."""
        return _NAMES[self.reason_code.cpu().numpy()]

    def counts(self) -> dict[str, int]:
        """Number of rows per reason, only those that occur."""
        number = torch.bincount(self.reason_code.flatten().long(), minlength=len(PlanReason)).tolist()
        return {reason.name: number[reason] for reason in PlanReason if number[reason]}

    def raise_if_failed(self) -> OptimizedTrajectory:
        """Return self if every row succeeded.

        Raises:
            PlanningError: some rows failed; the message says which and why, ``.result`` is this object.
        """
        failed = torch.nonzero(~self.success)
        if len(failed) == 0:
            return self
        told = "; ".join(self._tell(tuple(index)) for index in failed[:3].tolist())
        more = f"; and {len(failed) - 3} more" if len(failed) > 3 else ""
        raise PlanningError(f"{len(failed)} of {self.success.numel()} trajectories failed: {told}{more}", self)

    def _tell(self, index: tuple[int, ...]) -> str:
        where = f"[{', '.join(map(str, index))}]" if index else ""
        reason, gap = PlanReason(int(self.reason_code[index])), float(self.clearance[index])
        if reason in (PlanReason.start_collides, PlanReason.goal_collides):
            end = "q_start" if reason == PlanReason.start_collides else "q_goal"
            return f"{end}{where} touches an obstacle or is nearer than margin ({reason.name})"
        return f"row {list(index)} found no way (smallest distance {gap:.3g} m); try more restarts, vias or less margin"
