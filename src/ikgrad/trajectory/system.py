"""The linear system behind a trajectory: from points, times and end conditions to polynomial coefficients.

The unknowns are velocity and acceleration at every point (`kinds` has the equations). The matrix depends on the times
alone: it is solved once, in float64, for unit right sides, and a product with the points finishes any number of
trajectories. Everything is a torch operation, so gradients reach points, end conditions and times.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.trajectory.kinds import TAIL, Equation, Kind, equations


class EndCondition(NamedTuple):
    """A derivative given at the first or the last point."""

    last: bool
    order: int  # 1: velocity, 2: acceleration
    value: Tensor  # (..., n)


def solve_coefficients(points: Tensor, times: Tensor, kind: Kind, ends: list[EndCondition]) -> Tensor:
    """Coefficients of all segments in powers of their local time.

    Args:
        points: (..., m, n) float64.
        times: (..., m) float64, rising.
        kind: the degrees.
        ends: four end conditions, or two for cubics.

    Returns:
        (..., m - 1, d + 1, n) ascending powers, d the largest degree.
    """
    m = points.shape[-2]
    degrees = kind.degrees(m - 1)
    scale = (times[..., -1:] - times[..., :1]) / (m - 1)  # the mean duration becomes the unit of time
    h = times.diff(dim=-1) / scale  # (..., m - 1)
    scaled = torch.broadcast_tensors(*(end.value * scale**end.order for end in ends))
    given = torch.stack(scaled, dim=-2)  # (..., ends, n)
    batch = torch.broadcast_shapes(points.shape[:-2], given.shape[:-2])
    data = torch.cat([points.expand(*batch, *points.shape[-2:]), given.expand(*batch, *given.shape[-2:])], dim=-2)
    via = _response(h, equations(degrees), ends) @ data  # (..., 2 m, n)
    coefficients = _taylor(points, via.unflatten(-2, (m, 2)), h, degrees)
    powers = torch.arange(coefficients.shape[-2], device=points.device)
    return coefficients / ((h * scale)[..., None] ** powers)[..., None]


def _response(h: Tensor, inside: list[Equation], ends: list[EndCondition]) -> Tensor:
    """(..., 2 m, m + ends): v_0, a_0, v_1, a_1, ... at the points as a linear function of points and end conditions."""
    m, count = h.shape[-1] + 1, len(ends)
    rows = _rows(h, inside)  # (..., 2 m - ends, 3 m)
    unknown = torch.tensor([2 * (m - 1) * end.last + end.order - 1 for end in ends], device=h.device)
    unit = torch.nn.functional.one_hot(unknown, 2 * m).to(h).expand(*h.shape[:-1], count, 2 * m)
    matrix = torch.cat([rows[..., m:], unit], dim=-2)
    points = torch.nn.functional.pad(-rows[..., :m], (0, count))
    given = torch.nn.functional.pad(torch.eye(count).to(h), (m, 0)).expand(*h.shape[:-1], count, m + count)
    return torch.linalg.solve(matrix, torch.cat([points, given], dim=-2))


def _rows(h: Tensor, inside: list[Equation]) -> Tensor:
    """(..., e, 3 m): the e equations inside as rows over p_0 ... p_(m-1), then v_0, a_0, v_1, a_1, ..."""
    m = h.shape[-1] + 1
    local = _changes(h)  # (..., m - 1, 3, 6)
    order = torch.tensor([equation.order for equation in inside], device=h.device)
    left = [equation.left for equation in inside]
    right = [equation.right or equation.left._replace(weights=(0, 0, 0)) for equation in inside]
    here, there = (torch.tensor([t.segment for t in side], dtype=torch.long, device=h.device) for side in (left, right))
    shorter = torch.minimum(h[..., here], h[..., there])  # both sides times shorter^order: no entry grows with 1 / h
    rows = h.new_zeros(*h.shape[:-1], len(inside), 3 * m)
    for sign, side, segment in ((1, left, here), (-1, right, there)):
        weights = torch.tensor([t.weights for t in side], dtype=h.dtype, device=h.device).reshape(-1, 1, 3)
        entries = (weights @ local[..., segment, :, :])[..., 0, :]  # (..., e, 6)
        entries = sign * entries * ((shorter / h[..., segment]) ** order)[..., None]
        k = segment[:, None]
        columns = torch.cat([k, k + 1, m + 2 * k + torch.arange(4, device=h.device)], dim=-1)
        rows = rows.scatter_add(-1, columns.expand_as(entries), entries)
    return rows


def _changes(h: Tensor) -> Tensor:
    """(..., S, 3, 6): r0, r1, r2 of `kinds` as weights of p0, p1, v0, a0, v1, a1."""
    o, one, square = torch.zeros_like(h), torch.ones_like(h), h * h
    rows = [
        [-one, one, -h, -square / 2, o, o],
        [o, o, -h, -square, h, o],
        [o, o, o, -square, o, square],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def _taylor(points: Tensor, via: Tensor, h: Tensor, degrees: tuple[int, ...]) -> Tensor:
    """(..., S, d + 1, n) coefficients of u = s / h; ``via`` is (..., m, 2, n), velocity and acceleration."""
    batch = torch.broadcast_shapes(points.shape[:-2], via.shape[:-3])
    points, via = points.expand(*batch, *points.shape[-2:]), via.expand(*batch, *via.shape[-3:])
    ends = torch.stack([points[..., :-1, :], points[..., 1:, :]], dim=-2)  # (..., S, 2, n)
    local = torch.cat([ends, via[..., :-1, :, :], via[..., 1:, :, :]], dim=-2)  # (..., S, 6, n)
    tail = torch.tensor([TAIL[degree] for degree in degrees], dtype=h.dtype, device=h.device)
    high = tail @ (_changes(h) @ local)  # (..., S, 3, n)
    step = h[..., None, None]
    low = torch.cat([local[..., :1, :], step * local[..., 2:3, :], step**2 / 2 * local[..., 3:4, :]], dim=-2)
    return torch.cat([low, high[..., : max(degrees) - 2, :]], dim=-2)
