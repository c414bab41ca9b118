"""Denavit-Hartenberg parameters, in both conventions.

    standard:  A_i = Rot_z(theta_i) Trans_z(d_i) Trans_x(a_i)     Rot_x(alpha_i)
    modified:  A_i = Rot_x(alpha_{i-1}) Trans_x(a_{i-1}) Rot_z(theta_i) Trans_z(d_i)

For a turning joint theta_i = q_i + theta, for a sliding one d_i = q_i + d.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.errors import RobotError, ShapeError, UnknownNameError
from ikgrad.robot import Robot
from ikgrad.segments import MOVING, Segment, Variable

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

KEYS = ("theta", "d", "a", "alpha")


def from_dh(
    rows: Sequence[Mapping[str, Any] | Sequence[float]],
    *,
    convention: str,
    q_min: ArrayLike | None = None,
    q_max: ArrayLike | None = None,
    name: str = "robot",
) -> Robot:
    """A robot from Denavit-Hartenberg rows.

    Args:
        rows: one per joint: a mapping with any of ``theta``, ``d``, ``a``, ``alpha`` (missing ones are 0) and
            ``kind`` ("revolute" or "prismatic"), or four numbers in the order theta, d, a, alpha; m and rad.
            In the modified convention row i holds a_{i-1} and alpha_{i-1}.
        convention: "standard" or "modified" (Craig).
        q_min: (n,) lower limits; default: none.
        q_max: (n,) upper limits; default: none.
        name: name of the robot.

    Raises:
        ShapeError: limits of the wrong length.
        RobotError: no rows, a row that is not understood, swapped limits.

    Example:
        Two links of 1 m in a plane:

        >>> import ikgrad as ik, torch
        >>> arm = ik.Robot.from_dh([dict(a=1.0), dict(a=1.0)], convention="standard", name="elbow")
        >>> ik.forward_kinematics(arm, torch.zeros(2, dtype=torch.float64))[:3, 3]
        tensor([2., 0., 0.], dtype=torch.float64)
    """
    if convention not in ("standard", "modified"):
        raise UnknownNameError("convention", str(convention), ("standard", "modified"))
    if len(rows) == 0:
        raise RobotError(f"robot '{name}' has no DH rows")
    parsed = [_parse_row(name, i, row) for i, row in enumerate(rows)]
    limits = [_limits(name, key, value, len(rows)) for key, value in (("q_min", q_min), ("q_max", q_max))]
    variables = []
    for i, (_, kind) in enumerate(parsed):
        low, high = float(limits[0][i]), float(limits[1][i])
        if low > high or np.isnan([low, high]).any():
            raise RobotError(f"robot '{name}': limits of joint_{i + 1} are swapped or NaN ({low:g} > {high:g})")
        variables.append(Variable(f"joint_{i + 1}", kind, low, high))
    build = _standard if convention == "standard" else _modified
    return Robot(name, "base", tuple(build(parsed)), tuple(variables))


def _parse_row(name: str, i: int, row: Mapping[str, Any] | Sequence[float]) -> tuple[dict[str, float], str]:
    if not isinstance(row, Mapping):
        row = dict(zip(KEYS, row, strict=True)) if len(row) == len(KEYS) else {"?": row}
    unknown = [key for key in row if key not in (*KEYS, "kind")]
    if unknown:
        raise RobotError(
            f"robot '{name}': DH row {i + 1} must be four numbers (theta, d, a, alpha) or a mapping with keys "
            f"theta, d, a, alpha, kind; got {row.get('?', row)!r}"
        )
    kind = str(row.get("kind", "revolute"))
    if kind not in MOVING:
        raise RobotError(f"robot '{name}': DH row {i + 1} has kind '{kind}', allowed are {', '.join(MOVING)}")
    values = {key: float(row.get(key, 0.0)) for key in KEYS}
    if not np.isfinite(list(values.values())).all():
        raise RobotError(f"robot '{name}': DH row {i + 1} has a value that is not finite: {values}")
    return values, kind


def _limits(name: str, key: str, value: ArrayLike | None, n: int) -> np.ndarray:
    if value is None:
        return np.full(n, -np.inf if key == "q_min" else np.inf)
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (n,):
        raise ShapeError(f"{key} must have shape ({n},) for robot '{name}', got {array.shape}")
    return array


def _transform(*, theta: float = 0.0, d: float = 0.0, a: float = 0.0, alpha: float = 0.0) -> np.ndarray:
    """Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha); quarter turns come out exact."""
    ct, st, ca, sa = (
        round(x) if abs(x - round(x)) < 1e-15 else x
        for x in (np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha))
    )
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _standard(rows: list[tuple[dict[str, float], str]]) -> list[Segment]:
    """The part after the joint of row i becomes the origin of row i + 1, the last one a fixed flange."""
    segments, after = [], np.eye(4)
    for i, (row, kind) in enumerate(rows):
        if kind == "revolute":
            origin, after = after @ _transform(theta=row["theta"]), _transform(**{**row, "theta": 0.0})
        else:
            origin = after @ _transform(theta=row["theta"], d=row["d"])
            after = _transform(a=row["a"], alpha=row["alpha"])
        segments.append(Segment(f"joint_{i + 1}", f"link_{i + 1}", origin, kind, variable=i))
    return [*segments, Segment("flange_joint", "flange", after)]


def _modified(rows: list[tuple[dict[str, float], str]]) -> list[Segment]:
    """Rot_x, Trans_x come before the joint; Rot_z and Trans_z share an axis and may swap."""
    segments = []
    for i, (row, kind) in enumerate(rows):
        before = _transform(a=row["a"], alpha=row["alpha"]) @ _transform(theta=row["theta"], d=row["d"])
        segments.append(Segment(f"joint_{i + 1}", f"link_{i + 1}", before, kind, variable=i))
    return segments
