"""Smooth joint trajectories through via points: piecewise polynomials of time, differentiable and batched.

    trajectory = ik.via_point_trajectory(points, times, kind="4-3-4")
    q = trajectory.position(t)

Nothing here knows a robot: a joint is a column of numbers, in rad or m. Conventions: ``points`` are (..., m, n), m
points of n joints; S = m - 1 segments lie between them; inside segment k runs the local time s = t - times[k], from 0
to the duration h_k. Derivatives are with respect to time.

    kinds    which degrees, and what is continuous    build    the door: `via_point_trajectory`
    system   the linear equations for the vias        curve    the result: `Trajectory`
    checks   where bad input is refused               extremes largest and smallest values of polynomials
"""

from __future__ import annotations

from ikgrad.trajectory.build import via_point_trajectory
from ikgrad.trajectory.curve import Trajectory

__all__ = ["Trajectory", "via_point_trajectory"]
