"""A robot's chain in the form that other packages understand: every joint turns about, or slides along, its own z."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ikgrad.bench.peers.base import UnsupportedError
from ikgrad.robot import Robot


class ZChain(NamedTuple):
    """T = O_1 M(q_1) O_2 M(q_2) ... O_n M(q_n) tool, with M(q) = Rz(q), or Trans(0, 0, q) for a slide."""

    origins: np.ndarray  # (n, 4, 4)
    slides: np.ndarray  # (n,) bool
    tool: np.ndarray  # (4, 4)
    q_min: np.ndarray  # (n,) finite
    q_max: np.ndarray  # (n,)


def z_chain(robot: Robot) -> ZChain:
    """The chain of a robot without mimic joints; unlimited joints get the range that samples are drawn from.

    Raises:
        UnsupportedError: joints are coupled.
    """
    tables = robot.tables()
    multiplier = tables.multiplier.numpy()
    if len(multiplier) != robot.dof or not np.array_equal(tables.variable.numpy(), np.arange(robot.dof)):
        raise UnsupportedError("mimic joints")
    if not np.isin(multiplier, (-1.0, 1.0)).all():
        raise UnsupportedError("geared joints")
    turns = [_z_to(axis * sign) for axis, sign in zip(tables.axes.numpy(), multiplier, strict=True)]
    slides = tables.prismatic.numpy()
    origins, before = [], np.eye(4)
    for k, turn in enumerate(turns):
        offset = float(tables.offset[k]) * multiplier[k]
        origins.append(before.T @ tables.origins[k].numpy() @ turn @ _motion(offset, bool(slides[k])))
        before = turn
    low, high = (limit.numpy().copy() for limit in robot.sampling_range)
    return ZChain(np.stack(origins), slides, before.T @ tables.tool.numpy(), low, high)


def limited(robot: Robot) -> Robot:
    """The same robot with finite limits on all joints."""
    low, high = (limit.tolist() for limit in robot.sampling_range)
    variables = [v._replace(q_min=a, q_max=b) for v, a, b in zip(robot.variables, low, high, strict=True)]
    return replace(robot, variables=tuple(variables), _tables={})


def zero_axes(chain: ZChain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes and steps from joint to joint at q = 0 in the base frame: H (n, 3), P (n + 1, 3), and the tip's R (3, 3)."""
    T = np.eye(4)
    axes, points = [], [np.zeros(3)]
    for origin in chain.origins:
        T = T @ origin
        axes.append(T[:3, 2])
        points.append(T[:3, 3])
    T = T @ chain.tool
    points.append(T[:3, 3])
    return np.stack(axes), np.diff(np.stack(points), axis=0), T[:3, :3]


def urdf_text(chain: ZChain) -> str:
    """The chain as a URDF file: links l0 ... ln and tip, joints j1 ... jn; 17 digits."""
    lines = ['<?xml version="1.0"?>', '<robot name="chain">', '<link name="tip"/>']
    lines += [f'<link name="l{k}"/>' for k in range(len(chain.origins) + 1)]
    for k, origin in enumerate(chain.origins):
        kind = "prismatic" if chain.slides[k] else "revolute"
        limit = f'<limit lower="{chain.q_min[k]:.17g}" upper="{chain.q_max[k]:.17g}" effort="1" velocity="1"/>'
        ends = f'<parent link="l{k}"/><child link="l{k + 1}"/>'
        axis = '<axis xyz="0 0 1"/>'
        lines.append(f'<joint name="j{k + 1}" type="{kind}">{ends}{_origin(origin)}{axis}{limit}</joint>')
    ends = f'<parent link="l{len(chain.origins)}"/><child link="tip"/>'
    lines.append(f'<joint name="flange" type="fixed">{ends}{_origin(chain.tool)}</joint>')
    return "\n".join([*lines, "</robot>"])


def rpy(R: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll), exact to rounding also at a pitch of 90 degrees."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    yaw = math.atan2(R[1, 0], R[0, 0]) if math.hypot(R[0, 0], R[1, 0]) > 1e-9 else 0.0
    c, s = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw


def _origin(T: np.ndarray) -> str:
    xyz, angles = (" ".join(f"{x:.17g}" for x in values) for values in (T[:3, 3], rpy(T[:3, :3])))
    return f'<origin xyz="{xyz}" rpy="{angles}"/>'


def _motion(value: float, slide: bool) -> np.ndarray:
    M = np.eye(4)
    if slide:
        M[2, 3] = value
    else:
        c, s = math.cos(value), math.sin(value)
        M[:2, :2] = ((c, -s), (s, c))
    return M


def _z_to(axis: np.ndarray) -> np.ndarray:
    """(4, 4) rotation whose third column is the unit axis."""
    T = np.eye(4)
    if axis[2] == 1.0:
        return T
    x = np.eye(3)[np.argmin(np.abs(axis))]
    x = x - (x @ axis) * axis
    x /= np.linalg.norm(x)
    T[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    return T
