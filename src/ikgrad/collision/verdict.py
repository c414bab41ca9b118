"""What `ikgrad.collision.check_motion` returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.errors import CollisionError


@dataclass(frozen=True, eq=False)
class MotionCheck:
    """Verdicts on a batch of motions.

    Attributes:
        free: (...) bool, proven: the arm touches no obstacle at any time.
        touches: (...) bool, proven: it does, at ``time`` and perhaps a little before. A motion that is neither comes
            within the tolerance of an obstacle (or its samples are too far apart to tell).
        time: (...) the first time at which it touches, else at which it could not be told free [s]; infinite
            where free.
        link: (...) int64, the segment of `link_segments` that is nearest to an obstacle then; -1 where free.
        obstacle: (...) int64, that obstacle; -1 where free.
        clearance: (...) the smallest distance met on the way [m], negative inside an obstacle; what comes after the
            first contact is not looked at, and the true minimum may lie a little lower.
        samples: (...) int64, configurations that were looked at.
        start: (...) the time at which the motion begins [s].
        names: names of the links at both ends of every segment.
    """

    free: Tensor
    touches: Tensor
    time: Tensor
    link: Tensor
    obstacle: Tensor
    clearance: Tensor
    samples: Tensor
    start: Tensor
    names: tuple[tuple[str, str], ...]

    @property
    def starts_touching(self) -> Tensor:
        """(...) bool, the motion already touches an obstacle where it begins."""
        return self.touches & (self.time == self.start)

    def raise_if_touching(self) -> MotionCheck:
        """Return self if every motion is free.

        Raises:
            CollisionError: some are not; the message says which, where and when, ``.check`` is this object.
        """
        bad = torch.nonzero(~self.free)
        if len(bad) == 0:
            return self
        told = "; ".join(self._tell(index) for index in bad[:3].tolist())
        more = f"; and {len(bad) - 3} more" if len(bad) > 3 else ""
        raise CollisionError(f"{len(bad)} of {self.free.numel()} motions are not free: {told}{more}", self)

    def _tell(self, index: Sequence[int]) -> str:
        at = tuple(index)
        start, end = self.names[int(self.link[at])]
        if bool(self.starts_touching[at]):
            verb = "already touches where it starts,"
        else:
            verb = "touches" if bool(self.touches[at]) else "comes too near to tell free"
        which = f"motion {', '.join(map(str, at))}" if at else "the motion"
        return (
            f"{which} {verb} at t = {self.time[at].item():.6g} s ({start} - {end}, obstacle {int(self.obstacle[at])})"
        )
