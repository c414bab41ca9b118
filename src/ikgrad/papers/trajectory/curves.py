"""The 4-3-4 curves of both destinations: eq. (5), the vias, the breaks, the hand, and scipy's splines."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.papers.printed import find_row, numbers
from ikgrad.papers.trajectory.arm import DESTINATIONS, VIA_TIMES, joint_places, point, trajectories
from ikgrad.papers.trajectory.matrix import left_side_434, matrix_434
from ikgrad.trajectory import Trajectory, via_point_trajectory

_POSITION = ("x_printed_unit", "y_corrected_unit", "z_printed_unit")


@dataclass(frozen=True)
class CurveRow:
    """The curve to one destination.

    Attributes:
        destination: as in Table 1.
        residual: largest residual of the 14 equations over all joints [rad, rad/s, rad/s^2].
        vias: largest distance of a joint from a via point or an end at its time [rad].
        velocity_jump: largest jump at a via [rad/s].
        acceleration_jump: the same of the acceleration [rad/s^2].
        hand_off: ((2,)) largest difference of the hand from the printed specific points, at t = 2 and 5.
        lowest_deg: smallest joint value on the way.
        highest_deg: largest joint value on the way.
    """

    destination: str
    residual: float
    vias: float
    velocity_jump: float
    acceleration_jump: float
    hand_off: tuple[float, ...]
    lowest_deg: float
    highest_deg: float


def four_points(destination: str) -> Tensor:
    """(4, 4) joint values at start, both vias and a destination [rad]."""
    return torch.stack([point(name) for name in ("start", "via_1", "via_2", destination)])


def check_curves(tf: float) -> tuple[CurveRow, ...]:
    """Both destinations."""
    return tuple(_curve_row(name, tf) for name in DESTINATIONS)


def scipy_difference(tf: float) -> float | None:
    """Largest difference from scipy's splines where the two mean the same, over both destinations; None without scipy.

    Three curves through the four points, with two derivatives: eq. (5) solved and evaluated by scipy against our
    4-3-4, scipy's clamped cubic spline against our cubic, and its spline of degree 5 against our quintic
    [rad, rad/s, rad/s^2].
    """
    if importlib.util.find_spec("scipy") is None:
        return None
    import numpy as np
    from scipy.interpolate import CubicSpline, PPoly, make_interp_spline
    from scipy.linalg import solve

    times, t, rest = np.array([0.0, *VIA_TIMES, tf]), np.linspace(0.0, tf, 401), np.zeros(4)
    worst = 0.0
    for name in DESTINATIONS:
        points = four_points(name)
        C = solve(matrix_434(*VIA_TIMES, tf).numpy(), left_side_434(points.mT).mT.numpy())
        pieces = np.zeros((5, 3, 4))  # descending powers, segments, joints
        for k, part in enumerate((C[:5], C[5:9], C[9:])):
            pieces[5 - len(part) :, k] = part[::-1]
        theirs = {
            "4-3-4": PPoly(pieces, times),
            "cubic": CubicSpline(times, points.numpy(), bc_type="clamped"),
            "quintic": make_interp_spline(
                times, points.numpy(), k=5, bc_type=([(1, rest), (2, rest)], [(1, rest), (2, rest)])
            ),
        }
        for kind, spline in theirs.items():
            ours = via_point_trajectory(points, times.tolist(), kind=kind)
            for order in range(3):
                off = torch.from_numpy(spline(t, order)) - ours(t.tolist(), derivative=order)
                worst = max(worst, off.abs().max().item())
    return worst


def coefficients(trajectory: Trajectory) -> Tensor:
    """(14, 4) a0 to a4, b0 to b3, c0 to c4 of every joint."""
    a, b, c = trajectory.coefficients
    return torch.cat([a, b[:4], c])


def _curve_row(destination: str, tf: float) -> CurveRow:
    points = four_points(destination)
    curve = trajectories(points[3], tf)
    times = [0.0, *VIA_TIMES, tf]
    left = left_side_434(points.mT).mT
    velocity_jump, acceleration_jump = (_jump(curve, order) for order in (1, 2))
    hand = joint_places(curve.position(list(VIA_TIMES)))[:, 2]
    wanted = torch.tensor([numbers(find_row("trajectory_table1", point=f"via_{k}"), *_POSITION) for k in (1, 2)])
    low, high = curve.extremes()
    return CurveRow(
        destination,
        residual=(matrix_434(*VIA_TIMES, tf) @ coefficients(curve) - left).abs().max().item(),
        vias=(curve.position(times) - points).abs().max().item(),
        velocity_jump=velocity_jump,
        acceleration_jump=acceleration_jump,
        hand_off=tuple((hand - wanted.double()).abs().amax(-1).tolist()),
        lowest_deg=low.min().rad2deg().item(),
        highest_deg=high.max().rad2deg().item(),
    )


def _jump(curve: Trajectory, order: int) -> float:
    """Largest jump of a derivative at the vias: each polynomial at its own end against the next at its start."""
    jumps = []
    for k, via in enumerate(VIA_TIMES):
        before = Trajectory(times=curve.times[k : k + 2], coefficients=curve.coefficients[k : k + 1])
        jumps.append(before(via, derivative=order) - curve(via, derivative=order))
    return torch.stack(jumps).abs().max().item()


__all__ = ["CurveRow", "check_curves", "coefficients", "four_points", "scipy_difference"]
