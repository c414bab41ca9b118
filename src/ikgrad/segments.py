"""A chain as a row of segments, and the same folded into tensors.

Segment k maps into the frame of the one before it by

    A_k(q) = origin_k * motion_k(multiplier_k * q[variable_k] + offset_k)

with motion a rotation about, or a translation along, a unit axis. Everything else (fixed links, tools, links passed in
the tip-to-base direction, mimic joints, Denavit-Hartenberg rows) is written in this one form.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

MOVING = ("revolute", "prismatic")


class Variable(NamedTuple):
    """One entry of ``q``: a joint that moves by itself. Unlimited joints have -inf and +inf."""

    name: str
    kind: str
    q_min: float
    q_max: float


class Segment(NamedTuple):
    """One link of the chain and the joint that moves it (see the module docstring)."""

    joint: str
    link: str | None  # None: a frame inside a reversed joint, no link of the robot
    origin: np.ndarray  # (4, 4)
    kind: str = "fixed"  # or one of MOVING
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    variable: int = -1  # column of q
    multiplier: float = 1.0
    offset: float = 0.0


class Tables(NamedTuple):
    """The chain with its fixed segments folded in, as tensors; m is the number of moving segments."""

    origins: Tensor  # (m, 4, 4) from the moving frame before (or the base) to this joint, q = 0
    axes: Tensor  # (m, 3) unit
    prismatic: Tensor  # (m,) bool
    variable: Tensor  # (m,) int64, column of q
    multiplier: Tensor  # (m,)
    offset: Tensor  # (m,)
    tool: Tensor  # (4, 4) from the last moving frame to the tip
    link_frame: Tensor  # (links,) int64, moving frame that carries the link; 0 is the base, k + 1 is frame k
    link_offset: Tensor  # (links, 4, 4) the link in that frame


class Geometry(NamedTuple):
    """Link parameters as tensors, for gradients with respect to them."""

    origins: Tensor  # (m, 4, 4)
    tool: Tensor  # (4, 4)


def is_pose(T: np.ndarray, tolerance: float = 1e-6) -> bool:
    """True if a (4, 4) array is a rigid transform."""
    R = T[:3, :3]
    return bool(
        np.isfinite(T).all()
        and np.abs(R @ R.T - np.eye(3)).max() <= tolerance
        and np.linalg.det(R) > 0
        and np.abs(T[3] - (0, 0, 0, 1)).max() <= tolerance
    )


def fold(segments: Sequence[Segment]) -> Tables:
    """Fold fixed segments into their neighbours, in float64 on the CPU."""
    moving: list[Segment] = []
    origins: list[np.ndarray] = []
    link_frame, link_offset = [0], [np.eye(4)]
    pending = np.eye(4)  # from the last moving frame to here
    for segment in segments:
        pending = pending @ segment.origin
        if segment.kind in MOVING:
            moving.append(segment)
            origins.append(pending)
            pending = np.eye(4)
        if segment.link is not None:
            link_frame.append(len(moving))
            link_offset.append(pending)
    return Tables(
        origins=torch.from_numpy(np.stack(origins)),
        axes=torch.tensor([s.axis for s in moving], dtype=torch.float64),
        prismatic=torch.tensor([s.kind == "prismatic" for s in moving]),
        variable=torch.tensor([s.variable for s in moving]),
        multiplier=torch.tensor([s.multiplier for s in moving], dtype=torch.float64),
        offset=torch.tensor([s.offset for s in moving], dtype=torch.float64),
        tool=torch.from_numpy(pending),
        link_frame=torch.tensor(link_frame),
        link_offset=torch.from_numpy(np.stack(link_offset)),
    )


def segment_limits(variables: Sequence[Variable], segment: Segment) -> tuple[float, float]:
    """Range of a moving segment's own joint value, from the limits of its variable."""
    variable = variables[segment.variable]
    ends = [segment.multiplier * x + segment.offset for x in (variable.q_min, variable.q_max)]
    return min(ends), max(ends)
