"""What `ikgrad.solve_ik` returns: joints, and what was measured about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import ConvergenceError


class Reason(IntEnum):
    """Why a row ended as it did."""

    converged = 0
    unreachable = 1  # farther away than the arm is long: certain
    joint_limits = 2  # the pose is met, but not inside the limits
    no_convergence = 3  # no solution found; there may be one
    invalid_target = 4  # NaN, infinite, or no rigid transform


_NAMES = np.array([reason.name for reason in Reason])


@dataclass(frozen=True, eq=False)
class IKSolution:
    """Joints for a batch of poses. Failure is data: every row has a finite ``q`` and measured errors.

    Attributes:
        q: (..., n) joint values [rad or m]; the best found where the row failed.
        success: (...) bool: both errors within tolerance, and inside the limits if they were asked for.
        reason_code: (...) int8, see `Reason`.
        position_error: (...) distance to the target [m], recomputed with forward kinematics in float64;
            NaN where the target is invalid.
        rotation_error: (...) angle to the target [rad], likewise.
        steps: (...) int64, iterations spent on the row, all restarts included.

    With ``solutions=k`` every field has one more batch dimension k, nearest to ``q0`` first.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 4, seed=0))
        >>> ik.solve_ik(robot, T).raise_if_failed().reason
        array(['converged', 'converged', 'converged', 'converged'], dtype='<U14')
    """

    q: Tensor
    success: Tensor
    reason_code: Tensor
    position_error: Tensor
    rotation_error: Tensor
    steps: Tensor

    @property
    def reason(self) -> np.ndarray:
        """(...) array of str: the names of `Reason`."""
        return _NAMES[self.reason_code.cpu().numpy()]

    def counts(self) -> dict[str, int]:
        """Number of rows per reason, only those that occur."""
        number = torch.bincount(self.reason_code.flatten().long(), minlength=len(Reason)).tolist()
        return {reason.name: number[reason] for reason in Reason if number[reason]}

    def reshape(self, shape: Sequence[int]) -> IKSolution:
        """The same rows in another batch shape."""
        q = self.q.reshape((*shape, self.q.shape[-1]))
        names = ("success", "reason_code", "position_error", "rotation_error", "steps")
        return IKSolution(q, *(getattr(self, name).reshape(tuple(shape)) for name in names))

    def raise_if_failed(self) -> IKSolution:
        """Return self if every row succeeded.

        Raises:
            ConvergenceError: some rows failed; the message counts them by reason, ``.solution`` is this object.
        """
        failed = ~self.success
        if not bool(failed.any()):
            return self
        reasons = ", ".join(f"{n} {name}" for name, n in self.counts().items() if name != "converged")
        worst_position = self.position_error[failed].nan_to_num(0.0).max().item()
        worst_rotation = self.rotation_error[failed].nan_to_num(0.0).max().item()
        message = (
            f"{int(failed.sum())} of {failed.numel()} rows failed ({reasons}); worst errors {worst_position:.3g} m and "
            f"{worst_rotation:.3g} rad. Try another q0 or seed, limits=False, a mask, or looser tolerances."
        )
        raise ConvergenceError(message, self)
