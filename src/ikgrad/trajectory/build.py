"""The door: via points, times and end conditions in, a `Trajectory` out."""

from __future__ import annotations

from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.trajectory.checks import Numbers, check_end, check_points, check_times
from ikgrad.trajectory.curve import Trajectory
from ikgrad.trajectory.kinds import Kind, find_kind
from ikgrad.trajectory.system import EndCondition, solve_coefficients


def via_point_trajectory(
    points: Tensor,
    times: Numbers,
    *,
    kind: str = "4-3-4",
    start_velocity: Numbers | None = None,
    end_velocity: Numbers | None = None,
    start_acceleration: Numbers | None = None,
    end_acceleration: Numbers | None = None,
) -> Trajectory:
    """The smooth joint trajectory that is at each point at its time.

    Position, velocity and acceleration are continuous; velocities at the vias are results, not inputs. Between m points
    lie S = m - 1 polynomials of the local time s = t - times[k]::

        "4-3-4"    degrees 4, 3, ..., 3, 4: a cubic spline that can also start and end with given accelerations
        "3-5-3"    degrees 3, 5, ..., 5, 3: at least four points; jerk and snap continuous between quintics
        "cubic"    cubic spline: the smallest integral of squared acceleration
        "quintic"  quintic spline: the smallest integral of squared jerk; jerk and snap continuous

    All but "cubic" take velocity and acceleration at both ends. "cubic" takes one of the two at each end: the velocity,
    or the acceleration if that alone is given. What is not given is zero: from rest to rest. One segment is one
    polynomial: a quintic for "4-3-4" and "quintic", a cubic for "cubic".

    The curve is linear in points and end conditions, and gradients flow to them and to the times. It can leave the
    interval that the points span: see `Trajectory.extremes`.

    Args:
        points: (..., m, n) joint values [rad or m], m >= 2.
        times: (m,) for all, or (..., m) one row a trajectory, rising [s].
        kind: one of the names above.
        start_velocity: a number for all joints or (..., n), at the first point.
        end_velocity: the same at the last point.
        start_acceleration: as ``start_velocity``.
        end_acceleration: as ``end_velocity``.

    Returns:
        A `Trajectory` of the dtype and on the device of ``points``, solved in float64. Its batch is what the batches of
        all arguments broadcast to.

    Raises:
        ShapeError: shapes do not fit, or there are fewer than two points.
        ConfigError: times do not rise; something is not finite; a cubic got both velocity and acceleration at an end.
        UnknownNameError: no such kind.

    Source:
        "4-3-4" on four points is eq. (5) of Ang, Tang, Mashohor, Arrifin, Solving Continuous Trajectory and Forward
        Kinematics Simultaneously Based on ANN (2014), with its misprints corrected; see ``docs/trajectories.md``.

    Differences:
        The unknowns are velocity and acceleration at the points, 2 m of them, instead of 14 coefficients; with more
        points the inner segments are cubics ("4-3-4") or quintics ("3-5-3").

    Example:
        >>> import ikgrad as ik, torch
        >>> points = torch.tensor([[0.0, 0.0], [0.2, 0.7], [0.5, 0.4], [1.0, 1.0]], dtype=torch.float64)
        >>> trajectory = ik.via_point_trajectory(points, [0.0, 2.0, 5.0, 8.0])
        >>> trajectory.position([0.0, 5.0, 8.0])
        tensor([[0.0000, 0.0000],
                [0.5000, 0.4000],
                [1.0000, 1.0000]], dtype=torch.float64)
        >>> trajectory.velocity(8.0).abs().max() < 1e-12
        tensor(True)
    """
    check_points(points)
    found = find_kind(kind, points.shape[-2])
    given = check_times(times, points)
    start = _end(found, points, last=False, velocity=start_velocity, acceleration=start_acceleration)
    end = _end(found, points, last=True, velocity=end_velocity, acceleration=end_acceleration)
    coefficients = solve_coefficients(points.double(), given.double(), found, start + end)
    return Trajectory(times=given, coefficients=coefficients.to(points.dtype))


def _end(
    kind: Kind, points: Tensor, *, last: bool, velocity: Numbers | None, acceleration: Numbers | None
) -> list[EndCondition]:
    """The conditions at one end: velocity and acceleration, or one of them for cubics."""
    side = "end" if last else "start"
    if not kind.full_ends and velocity is not None and acceleration is not None:
        raise ConfigError(
            f"a cubic spline has one condition at each end: give {side}_velocity or {side}_acceleration, "
            "or take kind '4-3-4', which has both"
        )
    values = {1: ("velocity", velocity), 2: ("acceleration", acceleration)}
    if not kind.full_ends:
        del values[1 if acceleration is not None else 2]
    return [
        EndCondition(last, order, check_end(f"{side}_{name}", 0.0 if value is None else value, points).double())
        for order, (name, value) in values.items()
    ]
