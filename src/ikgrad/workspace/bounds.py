"""How far, and how near, the tip can be from the shoulder: certain bounds, so that such poses need no search.

A place (a joint's origin, or the tip) keeps its distance from another one while only joints move whose axes go through
one of the two. If exactly one more joint turns, about the axis a through o, the law of cosines has the distance: with
u and w the two places seen from o,

    d(q)^2 = |u|^2 + |w|^2 - 2 (c + A cos q + B sin q)
    c = (u a)(w a),   A = u w - c,   B = u (a x w)

whose extremes over the joint's range are known. Longer stretches of the chain are put together by the triangle
inequality, at whichever place that bounds best. `Robot.reach_bound` sums all lengths instead, so it is larger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ikgrad.robot import Robot
from ikgrad.segments import MOVING, segment_limits

Vector = np.ndarray
_ON_AXIS = 1e-12  # of the arm's length: how near a place must be to an axis to be on it


class Span(NamedTuple):
    """Bounds of a distance [m]."""

    least: float
    most: float


class Reach(NamedTuple):
    """Bounds of distances from the shoulder, a place that no joint moves."""

    shoulder: Vector  # (3,) in the base [m]
    wrist: Span  # of the last moving frame's origin
    tip: Span  # of the tip


def reach(robot: Robot) -> Reach:
    """Bounds that no configuration inside the joint limits can leave.

    Args:
        robot: any robot; mimic joints count as if they moved by themselves.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> round(reach(robot).tip.most, 2), round(robot.reach_bound, 2)
        (0.86, 0.99)
    """
    chain = _Chain.of(robot)
    tip, last = len(chain.slides), len(chain.slides) - 1
    spans = chain.spans()
    fixed = [k for k in range(tip) if k == 0 or chain.keeps(k, 0, k)]
    shoulder = min(fixed, key=lambda k: spans[k, tip].most)
    wrist = Span(0.0, math.inf) if chain.slides[last] else spans.get((shoulder, last), Span(0.0, 0.0))
    return Reach(chain.places[shoulder].copy(), wrist, spans[shoulder, tip])


@dataclass(frozen=True, eq=False)
class _Chain:
    """The robot with all joint values 0, in the base."""

    places: Vector  # (m + 1, 3) of the joints before they move, and of the tip
    axes: Vector  # (m, 3) unit
    slides: list[bool]  # (m,)
    ends: list[tuple[float, float]]  # (m,) ranges

    @classmethod
    def of(cls, robot: Robot) -> _Chain:
        tables = robot.detach().tables()
        T, places, axes = np.eye(4), [], []
        for origin, axis in zip(tables.origins.numpy(), tables.axes.numpy(), strict=True):
            T = T @ origin
            places.append(T[:3, 3])
            axes.append(T[:3, :3] @ axis)
        places.append((T @ tables.tool.numpy())[:3, 3])
        ends = [segment_limits(robot.variables, s) for s in robot.segments if s.kind in MOVING]
        return cls(np.array(places), np.array(axes), tables.prismatic.tolist(), ends)

    def keeps(self, place: int, first: int, last: int) -> bool:
        """True if the joints from first up to, but not, last leave a place where it is."""
        for k in range(first, last):
            step = self.places[place] - self.places[k]
            off = float(np.linalg.norm(np.cross(self.axes[k], step)))
            size = float(np.abs(self.places).max()) or 1.0
            if self.slides[k] or off > _ON_AXIS * size:
                return False
        return True

    def spans(self) -> dict[tuple[int, int], Span]:
        """Bounds between all pairs of places, i < j."""
        tip = len(self.slides)
        spans: dict[tuple[int, int], Span] = {}
        for length in range(1, tip + 1):
            for i in range(tip + 1 - length):
                spans[i, i + length] = self._between(spans, i, i + length)
        return spans

    def _between(self, spans: dict[tuple[int, int], Span], i: int, j: int) -> Span:
        """The best bounds from place i to j, those of shorter stretches being known."""
        found = [self._across(i, k, j) for k in range(i, j) if self.keeps(i, i + 1, k) and self.keeps(j, k + 1, j)]
        found += [_sum(spans[i, k], spans[k, j]) for k in range(i + 1, j)]
        return Span(max(span.least for span in found), min(span.most for span in found))

    def _across(self, i: int, k: int, j: int) -> Span:
        """From i to j while joint k moves alone."""
        o, axis, ends = self.places[k], self.axes[k], self.ends[k]
        if k > i and self.slides[i]:
            return Span(0.0, math.inf)  # joint i moves all that follows away from its place
        if self.slides[k]:
            return _slide(self.places[j] - self.places[i], axis, ends)
        return _turn(self.places[i] - o, self.places[j] - o, axis, ends)


def _slide(step: Vector, axis: Vector, ends: tuple[float, float]) -> Span:
    """|step + s axis| for s between the ends."""
    if not all(map(math.isfinite, ends)):
        return Span(0.0, math.inf)
    nearest = min(max(-float(step @ axis), ends[0]), ends[1])
    least, *others = (float(np.linalg.norm(step + s * axis)) for s in (nearest, *ends))
    return Span(least, max(others))


def _turn(u: Vector, w: Vector, axis: Vector, ends: tuple[float, float]) -> Span:
    """See the module's equation."""
    c = float(u @ axis) * float(w @ axis)
    A, B = float(u @ w) - c, float(u @ np.cross(axis, w))
    top = math.atan2(B, A)
    values = [math.hypot(A, B) * sign for sign, at in ((1, top), (-1, top + math.pi)) if _within(at, ends)]
    values += [A * math.cos(q) + B * math.sin(q) for q in ends if math.isfinite(q)]
    squares = [max(0.0, float(u @ u + w @ w) - 2 * (c + value)) for value in values]
    return Span(math.sqrt(min(squares)), math.sqrt(max(squares)))


def _within(angle: float, ends: tuple[float, float]) -> bool:
    """True if a whole number of turns brings the angle between the ends."""
    low, high = ends
    if not high - low < 2 * math.pi:
        return True
    return low + (angle - low) % (2 * math.pi) <= high


def _sum(a: Span, b: Span) -> Span:
    """The triangle inequality."""
    if not (math.isfinite(a.most) and math.isfinite(b.most)):
        return Span(0.0, math.inf)
    return Span(max(a.least - b.most, b.least - a.most, 0.0), a.most + b.most)
