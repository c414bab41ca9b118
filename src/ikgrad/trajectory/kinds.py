"""The kinds of trajectory: a degree for every segment, and the equations that this leaves open.

Position, velocity and acceleration (p, v, a) at both ends of a segment determine a polynomial of degree 5. So take v
and a at every point as the unknowns, 2 m of them: then everything up to the acceleration is continuous whatever they
are. A segment of lower degree asks that its high coefficients vanish, and a via between two quintics can also have a
continuous jerk and snap. Each of these is one equation, and with the conditions at the two ends they are 2 m again:

    kind       degrees           equations inside            conditions at each end
    4-3-4      4, 3, ..., 3, 4   1 + 2 (S - 2) + 1           velocity and acceleration
    3-5-3      3, 5, ..., 5, 3   2 + 2 (S - 3) + 2           velocity and acceleration
    cubic      3, ..., 3         2 S                         velocity or acceleration
    quintic    5, ..., 5         2 (S - 1)                   velocity and acceleration

In the normalised time u = s / h of a segment, with the changes that a parabola from its start leaves unexplained

    r0 = p1 - p0 - v0 h - a0 h^2 / 2,   r1 = (v1 - v0 - a0 h) h,   r2 = (a1 - a0) h^2

the coefficients of u^3, u^4, u^5 are ``TAIL[degree] @ r``; ``CLOSING[degree] @ r = 0`` says that the degree suffices.
"""

from __future__ import annotations

from typing import NamedTuple

from ikgrad.errors import ConfigError, UnknownNameError

Row3 = tuple[float, float, float]

TAIL: dict[int, tuple[Row3, Row3, Row3]] = {
    3: ((1, 0, 0), (0, 0, 0), (0, 0, 0)),
    4: ((4, -1, 0), (-3, 1, 0), (0, 0, 0)),
    5: ((10, -4, 0.5), (-15, 7, -1), (6, -3, 0.5)),
}
CLOSING: dict[int, tuple[Row3, ...]] = {3: ((-3, 1, 0), (-6, 0, 1)), 4: ((12, -6, 1),), 5: ()}

# d^3/du^3 and d^4/du^4 of a quintic at its end (u = 1) and at its start (u = 0), as weights of r.
JERK_AND_SNAP: tuple[tuple[int, Row3, Row3], ...] = (
    (3, (60, -36, 9), (60, -24, 3)),
    (4, (360, -192, 36), (-360, 168, -24)),
)


class Kind(NamedTuple):
    """Degrees of the first, the inner and the last segments."""

    ends: int
    inner: int
    least_points: int = 2

    @property
    def full_ends(self) -> bool:
        """True if velocity *and* acceleration are given at each end."""
        return max(self.ends, self.inner) > 3

    def degrees(self, segments: int) -> tuple[int, ...]:
        """Degree of every segment; a single segment carries the conditions of both ends."""
        if segments == 1:
            return (2 * self.ends - self.inner,)
        return (self.ends, *[self.inner] * (segments - 2), self.ends)


KINDS = {"4-3-4": Kind(4, 3), "3-5-3": Kind(3, 5, least_points=4), "cubic": Kind(3, 3), "quintic": Kind(5, 5)}


def find_kind(name: str, points: int) -> Kind:
    """The kind of this name; refuses one that cannot go through so few points."""
    if name not in KINDS:
        raise UnknownNameError("trajectory kind", str(name), KINDS)
    kind = KINDS[name]
    if points < kind.least_points:
        raise ConfigError(f"kind '{name}' needs at least {kind.least_points} points, got {points}; take '4-3-4'")
    return kind


class Term(NamedTuple):
    """``weights`` times the r of a segment."""

    segment: int
    weights: Row3


class Equation(NamedTuple):
    """left / h_left^order = right / h_right^order; a missing right side is 0."""

    order: int
    left: Term
    right: Term | None = None


def equations(degrees: tuple[int, ...]) -> list[Equation]:
    """All equations inside the trajectory, from its start to its end."""
    found: list[Equation] = []
    for k, degree in enumerate(degrees):
        if k > 0 and degree == degrees[k - 1] == 5:
            found += [Equation(order, Term(k - 1, end), Term(k, start)) for order, end, start in JERK_AND_SNAP]
        found += [Equation(0, Term(k, weights)) for weights in CLOSING[degree]]
    return found
