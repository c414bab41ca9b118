"""A path through points as a linear function of the points, in a time that runs from 0 to 1.

`ikgrad.via_point_trajectory` is linear in its points, so a few small matrices, made once, stand for it: W takes the
points to samples of the path, and K is the exact integral of the squared jerk as a quadratic form of the points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.trajectory import Trajectory, via_point_trajectory

# Integral of the squared jerk of 10 u^3 - 15 u^4 + 6 u^5, the least for a way of length one from rest to rest.
_LEAST_JERK = 720.0


class Curve(NamedTuple):
    """Paths through m points, the first and the last of them given, v = m - 2 free."""

    times: Tensor  # (m,) evenly spaced, 0 to 1
    samples: Tensor  # (N, m) W: weights of the points in N samples between the ends
    shown: Tensor  # (T, m) the same at many times, both ends included
    jerk: Tensor  # (m, m) K: the integral of the squared jerk is 720 points^T K points, joint by joint
    coefficients: Tensor  # (S, d + 1, m) weights of the points in the polynomials

    def at_samples(self, points: Tensor) -> Tensor:
        """(B, m, n) points -> (B, N, n) samples."""
        return each(self.samples, points)

    def trajectories(self, points: Tensor) -> Trajectory:
        """The curves through points (B, m, n), every one with times of its own."""
        times = self.times.expand(len(points), -1)
        flat = each(self.coefficients.flatten(0, 1), points)
        return Trajectory(times, flat.unflatten(1, self.coefficients.shape[:2]))


def make_curve(vias: int, kind: str, per_segment: int, shown: int, device: torch.device) -> Curve:
    """The matrices for so many free vias.

    Args:
        vias: free points between start and goal.
        kind: a kind of `ikgrad.via_point_trajectory`.
        per_segment: samples between two points.
        shown: how many times to look at in the end.
        device: where they shall lie.
    """
    m = vias + 2
    times = torch.linspace(0, 1, m, dtype=torch.float64)
    unit = via_point_trajectory(torch.eye(m, dtype=torch.float64), times, kind=kind)
    samples = unit.position(torch.linspace(0, 1, per_segment * (m - 1) + 1, dtype=torch.float64)[1:-1])
    many = unit.position(torch.linspace(0, 1, shown, dtype=torch.float64))
    # Three Gauss points a segment: exact for the square of a jerk of degree two.
    node = math.sqrt(0.6) * torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)
    weight = torch.tensor([5.0, 8.0, 5.0], dtype=torch.float64) / (18 * (m - 1))
    third = unit.jerk((times[:-1, None] + (node + 1) / (2 * (m - 1))).flatten())  # (3 (m - 1), m)
    jerk = (third * weight.repeat(m - 1)[:, None]).mT @ third / _LEAST_JERK
    return Curve(*(x.to(device) for x in (times, samples, many, jerk, unit.coefficients)))


def each(matrix: Tensor, rows: Tensor) -> Tensor:
    """``matrix @ rows`` for (a, b) and (B, b, n), one product a row, with bits that do not depend on B.

    The products of a BLAS round differently when a matrix begins elsewhere in a cache line, so all are made to begin
    at the same place in theirs.
    """
    return matrix.expand(len(rows), -1, -1).bmm(aligned(rows))[..., : rows.shape[-1]]


def aligned(rows: Tensor) -> Tensor:
    """Zeros behind the last dimension, up to a multiple of 64 bytes (eight float64)."""
    return torch.nn.functional.pad(rows, (0, -rows.shape[-1] % 8))
