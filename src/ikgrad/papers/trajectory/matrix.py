"""Eq. (5): the 14 equations of a 4-3-4 trajectory for one joint, with every row labelled.

Three polynomials, each in its own local time s that starts at 0::

    0 <= t <= ta    a0 + a1 s + a2 s^2 + a3 s^3 + a4 s^4    s = t
    ta <= t <= tb   b0 + b1 s + b2 s^2 + b3 s^3             s = t - ta
    tb <= t <= tf   c0 + c1 s + c2 s^2 + c3 s^3 + c4 s^4    s = t - tb

This is the paper's own form, written down by differentiating monomials. `ikgrad.via_point_trajectory` solves the same
problem in another one, for any number of points, and the tests hold each against the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import ConfigError

COLUMNS = ("a0", "a1", "a2", "a3", "a4", "b0", "b1", "b2", "b3", "c0", "c1", "c2", "c3", "c4")
_FIRST = {"a": (0, 5), "b": (5, 4), "c": (9, 5)}  # first column and number of coefficients
_ORDER = ("position", "velocity", "acceleration")


class MatrixRow(NamedTuple):
    """One equation: what it says, and its left side in the paper and as it must be."""

    label: str
    printed: str
    corrected: str
    segment: str
    order: int  # derivative
    at_end: bool  # of the segment, else at its start
    minus_next: bool = False  # the same derivative at the start of the next segment is subtracted


def _ends(segment: str, where: str, name: str, corrected: str, at_end: bool) -> tuple[MatrixRow, ...]:
    """Position, velocity and acceleration are given."""
    return tuple(
        MatrixRow(f"{_ORDER[order]} at {where}", f"{dots}{name}", f"{dots}{corrected}", segment, order, at_end)
        for order, dots in enumerate(("theta_", "dtheta_", "ddtheta_"))
    )


def _via(before: str, after: str, number: int) -> tuple[MatrixRow, ...]:
    """Position from both sides; velocity and acceleration are continuous."""
    printed, right = f"theta_{number + 1}", f"theta_via{number}"
    where = f"via {number}"
    return (
        MatrixRow(f"position at {where}, from before", printed, right, before, 0, True),
        MatrixRow(f"position at {where}, from after", f"d{printed}", right, after, 0, False),
        MatrixRow(f"velocity continuous at {where}", "0", "0", before, 1, True, minus_next=True),
        MatrixRow(f"acceleration continuous at {where}", "0", "0", before, 2, True, minus_next=True),
    )


ROWS: tuple[MatrixRow, ...] = (
    *_ends("a", "the start", "1", "start", at_end=False),
    *_via("a", "b", 1),
    *_via("b", "c", 2),
    *_ends("c", "the end", "4", "final", at_end=True),
)


def matrix_434(ta: float, tb: float, tf: float) -> Tensor:
    """The matrix M of eq. (5), theta = M C, corrected.

    Source:
        eq. (5).

    Differences:
        Rows 1 to 11 are printed with 13 entries; the missing one is a zero at the right end. tc is tf - tb (printed
        tf - ta - tb), since ta and tb are instants.

    Args:
        ta: instant of via 1 [s], after 0.
        tb: instant of via 2 [s].
        tf: instant of the end [s].

    Returns:
        (14, 14) float64; rows as in `ROWS`, columns as in `COLUMNS`.

    Raises:
        ConfigError: the instants do not rise.

    Example:
        >>> matrix_434(2.0, 5.0, 8.0)[3, :5]
        tensor([ 1.,  2.,  4.,  8., 16.], dtype=torch.float64)
    """
    if not 0 < ta < tb < tf < math.inf:
        raise ConfigError(f"instants must rise, 0 < ta < tb < tf, got {ta:g}, {tb:g}, {tf:g}")
    duration = {"a": ta, "b": tb - ta, "c": tf - tb}
    matrix = torch.zeros(len(ROWS), len(COLUMNS), dtype=torch.float64)
    for line, row in zip(matrix, ROWS, strict=True):
        _put(line, row.segment, row.order, duration[row.segment] if row.at_end else 0.0)
        if row.minus_next:
            _put(line, "b" if row.segment == "a" else "c", row.order, 0.0, sign=-1)
    return matrix


def _put(line: Tensor, segment: str, order: int, s: float, sign: int = 1) -> None:
    """Write the derivative of 1, s, s^2, ... into the columns of a segment."""
    first, count = _FIRST[segment]
    for power in range(order, count):
        line[first + power] = sign * math.perm(power, order) * s ** (power - order)


def left_side_434(theta: Tensor) -> Tensor:
    """The left side of eq. (5) from rest to rest: positions where the paper prints velocities of the vias.

    Args:
        theta: (..., 4) joint values at start, via 1, via 2 and end [rad].

    Returns:
        (..., 14) in the order of `ROWS`.

    Example:
        >>> left_side_434(torch.tensor([0.0, 1.0, 2.0, 3.0])).int().tolist()
        [0, 0, 0, 1, 1, 0, 0, 2, 2, 0, 0, 3, 0, 0]
    """
    point = {"theta_start": 0, "theta_via1": 1, "theta_via2": 2, "theta_final": 3}
    zero = torch.zeros_like(theta[..., 0])
    values = [theta[..., point[row.corrected]] if row.corrected in point else zero for row in ROWS]
    return torch.stack(values, dim=-1)
