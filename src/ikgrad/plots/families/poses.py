"""Pose files: where the poses are."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.files.peek import Peek
from ikgrad.files.poses import COLUMNS, open_poses
from ikgrad.plots.families.base import Family, Found, Options

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def is_pose_table(columns: Collection[str]) -> bool:
    """Whether these are the columns of poses."""
    return set(COLUMNS) <= set(columns)


def find(looks: Sequence[Peek]) -> Found | None:
    """Columns of a pose, or matrices 4 x 4."""
    look = looks[0]
    matrices = (look.kind == ".npy" and look.shape[1:] == (4, 4)) or (look.kind == ".npz" and "poses" in look.columns)
    if not (matrices or (look.is_table() and is_pose_table(look.columns))):
        return None
    return {"places": lambda options: _places(look), "frames": lambda options: _frames(look, options)}


def _places(look: Peek) -> Figure:
    from ikgrad.plots.places import pose_places

    T = _poses(look)
    return pose_places(T.numpy(), title=f"{look.path.name}: {len(T):,} poses")


def _frames(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.places import pose_frames

    T = _poses(look)
    return pose_frames(T.numpy(), title=f"{look.path.name}: {len(T):,} poses")


def _poses(look: Peek) -> Tensor:
    """(N, 4, 4), without those that are not finite."""
    T = torch.cat([targets.T for targets in open_poses(look.path, kind=look.kind).chunks()])
    kept = T.isfinite().all(dim=-1).all(dim=-1)
    if not kept.any():
        raise DataError(f"{look.path}: no pose is finite, so there is nothing to draw")
    return T[kept]


FAMILY = Family("a pose file", find)
