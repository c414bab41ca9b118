"""The robot's chain as flat float64 arrays, with the frames turned so that the kernels do little work a joint."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ikgrad.engine.seeds import Seeds, build
from ikgrad.robot import Robot

FLOATS, KINDS = 9, 2  # numbers a joint in PackedChain.joints and .kinds


@dataclass(frozen=True, eq=False)
class PackedChain:
    """What the kernels know about a robot with m moving segments and n variables.

    Every joint axis is made the z axis of its frame, and a rotation R between two joints is split into
    ``Rz(a) Rx(b) Rz(c)``. ``Rz(a)`` moves into the joint before, ``Rz(c)`` into the joint's own offset, so that one
    joint costs a translation, a turn by b about x and a turn about z (or a slide along it):

        A_k(q) = Trans(x, y, z) Rx(b) Rz(theta),   theta = multiplier q + offset
        A_k(q) = Trans(x, y, z) Rx(b) Rz(c) Trans(0, 0, theta)   for a slide

    Unlike Denavit-Hartenberg parameters this is well conditioned for nearly parallel axes.
    """

    base: NDArray[np.float64]  # (12,) columns x, y, z, p of the first joint's frame, q = 0
    joints: NDArray[np.float64]  # (m * 9,) x, y, z, cos b, sin b, multiplier, offset, cos c, sin c
    kinds: NDArray[np.int64]  # (m * 2,) 1 if a slide, column of q
    tool: NDArray[np.float64]  # (12,) columns of the tip in the last moving frame
    q_min: NDArray[np.float64]  # (n,) -inf if there is none
    q_max: NDArray[np.float64]  # (n,)
    low: NDArray[np.float64]  # (n,) range that random starts are drawn from
    high: NDArray[np.float64]  # (n,)
    slide: NDArray[np.float64]  # (n,) 1 if the variable is a length, 0 if an angle
    length: float  # typical length of the arm [m]; errors in position count divided by it

    @cached_property
    def seeds(self) -> Seeds:
        """First guesses for the solver, made when first asked for."""
        return build(self)

    @cached_property
    def solver_tables(self) -> tuple[Any, ...]:
        """What the solve kernel takes: the fields above in their order, then the seeds'."""
        return (*(getattr(self, field.name) for field in fields(self)), *self.seeds)


_packed: weakref.WeakKeyDictionary[Robot, PackedChain] = weakref.WeakKeyDictionary()


def pack(robot: Robot) -> PackedChain:
    """The chain of a robot for the kernels (kept as long as the robot lives).

    Args:
        robot: any robot; mimic joints, slides and any number of joints are allowed.
    """
    chain = _packed.get(robot)
    if chain is None:
        chain = _packed[robot] = _pack(robot)
    return chain


def _pack(robot: Robot) -> PackedChain:
    tables = robot.tables()
    axes, slides = tables.axes.numpy(), tables.prismatic.numpy()
    multiplier, offset = tables.multiplier.numpy(), tables.offset.numpy()
    turns = [_z_to(axis) for axis in axes]
    local = [origin.numpy().copy() for origin in tables.origins]
    for k, turn in enumerate(turns):
        local[k][:3, :3] = local[k][:3, :3] @ turn
        if k > 0:
            local[k][:3] = turns[k - 1].T @ local[k][:3]
    tool = tables.tool.numpy().copy()
    tool[:3] = turns[-1].T @ tool[:3]

    joints = np.zeros((len(axes), FLOATS))
    joints[:, 5], joints[:, 6] = multiplier, offset
    c = np.zeros(len(axes))
    joints[0, 3] = 1.0  # the first frame is the base's business: Trans(0) Rx(0)
    for k in range(1, len(axes)):
        before, b, c[k] = _euler_zxz(local[k][:3, :3])
        c[k - 1] += before
        joints[k, :3] = _rz(before).T @ local[k][:3, 3]
        joints[k, 3:5] = b
    joints[:, 6] += np.where(slides, 0.0, c)
    joints[:, 7], joints[:, 8] = np.cos(c), np.sin(c)

    low, high = (limit.to("cpu").double().numpy().copy() for limit in robot.sampling_range)
    return PackedChain(
        base=_columns(local[0]),
        joints=joints.reshape(-1),
        kinds=np.stack([slides.astype(np.int64), tables.variable.numpy()], axis=1).reshape(-1),
        tool=_columns(tool),
        q_min=robot.q_min.to("cpu").double().numpy().copy(),
        q_max=robot.q_max.to("cpu").double().numpy().copy(),
        low=low,
        high=high,
        slide=(~robot.revolute).to("cpu").double().numpy().copy(),
        length=_typical_length(local, tool),
    )


def _typical_length(local: list[np.ndarray], tool: np.ndarray) -> float:
    """A length by which position errors are divided, so that arms of any size solve alike."""
    links = sum(float(np.linalg.norm(A[:3, 3])) for A in local[1:]) + float(np.linalg.norm(tool[:3, 3]))
    return links / 4 if links > 0 else 1.0


def _columns(T: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(T[:3].T).reshape(-1)


def _rz(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _z_to(axis: np.ndarray) -> np.ndarray:
    """(3, 3) rotation whose third column is the unit axis; the identity if that is z."""
    z = axis / np.linalg.norm(axis)
    if z[2] == 1.0:
        return np.eye(3)
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _euler_zxz(R: np.ndarray) -> tuple[float, tuple[float, float], float]:
    """a, (cos b, sin b), c with R = Rz(a) Rx(b) Rz(c), to rounding also where b is near 0 or pi."""
    sin_b = math.hypot(R[0, 2], R[1, 2])
    if sin_b < 1e-15:
        sin_b = 0.0
    norm = math.hypot(sin_b, R[2, 2])
    sin_b, cos_b = sin_b / norm, R[2, 2] / norm
    a = math.atan2(R[0, 2], -R[1, 2]) if sin_b > 0 else 0.0
    Rx = np.array([[1.0, 0.0, 0.0], [0.0, cos_b, -sin_b], [0.0, sin_b, cos_b]])
    rest = Rx.T @ _rz(a).T @ R  # about z whatever rounding did to a
    return a, (cos_b, sin_b), math.atan2(rest[1, 0] - rest[0, 1], rest[0, 0] + rest[1, 1])
