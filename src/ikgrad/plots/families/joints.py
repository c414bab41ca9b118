"""Joint files: those of ``ikgrad solve`` with their errors, and plain ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import DataError
from ikgrad.files.joints import RESULTS, open_joints
from ikgrad.files.peek import Peek
from ikgrad.files.results import read_results
from ikgrad.plots.families.base import Draw, Family, Found, Options
from ikgrad.plots.families.poses import is_pose_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ikgrad.robot import Robot

_GHOSTS, _POINTS = 5, 4000  # poses of the arm; rows of a curve


def find(looks: Sequence[Peek]) -> Found | None:
    """Columns of results, a matrix ``q`` with names, or a table or matrix of numbers that are no poses."""
    look = looks[0]
    with_results: dict[str, Draw] = {
        "summary": lambda options: _summary(look, options),
        "workspace": lambda options: _workspace(look, options),
    }
    plain: dict[str, Draw] = {
        "joints": lambda options: _joints(look, options),
        "arm": lambda options: _arm(look, options),
    }
    if set(RESULTS) <= set(look.columns):
        return with_results | plain
    if look.kind == ".npz":
        return plain if {"q", "joint_names"} <= set(look.columns) else None
    if look.kind == ".npy":
        return plain if len(look.shape) == 2 else None
    numbers = look.is_table() and not is_pose_table(look.columns) and "share" not in look.columns
    return plain if numbers and not all(map(_is_number, look.columns)) else None


def _is_number(name: str) -> bool:
    try:
        float(name)
    except ValueError:
        return False
    return True


def _summary(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.batch import solve_summary

    found = read_results(look.path, look.kind)
    errors = found["position_error_m"], found["rotation_error_rad"]
    name = f"{options.robot.name}, " if options.robot else ""
    title = f"{look.path.name}: {name}{len(found['steps']):,} rows"
    places = None if options.robot is None else _places(options.robot, _q(look, options.robot))
    return solve_summary(*errors, found["steps"], found["reason"], title=title, robot=options.robot, p=places)


def _workspace(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.workspace import workspace_errors

    robot = options.need_robot("the error over the workspace")
    found = read_results(look.path, look.kind)
    title = f"{look.path.name}: {robot.name}, {len(found['steps']):,} rows"
    p = _places(robot, _q(look, robot))
    return workspace_errors(robot, p, found["position_error_m"], found["success"], title=title)


def _joints(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.tracking import traces

    robot = options.need_robot("a figure of joints")
    q = _q(look, robot)
    every = max(1, len(q) // _POINTS)
    units = ["rad" if turns else "m" for turns in robot.revolute]
    panels = [f"{name}\n[{unit}]" for name, unit in zip(robot.joint_names, units, strict=True)]
    title = f"{look.path.name}: {robot.name}, {len(q):,} rows"
    rows = np.arange(len(q))[::every]
    return traces({"q": q[::every].numpy()}, panels=panels, x=rows, xlabel="row [-]", title=title)


def _arm(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.arm import arm_frames

    robot = options.need_robot("a figure of the arm")
    q = _q(look, robot)
    q = q[q.isfinite().all(dim=1)]
    if not len(q):
        raise DataError(f"{look.path}: no row is finite, so there is nothing to draw")
    rows = torch.linspace(0, len(q) - 1, min(len(q), _GHOSTS)).round().long()
    return arm_frames(robot, q[rows], title=f"{look.path.name}: {robot.name}, {len(rows)} of {len(q):,} rows")


def _q(look: Peek, robot: Robot) -> Tensor:
    return torch.cat(list(open_joints(look.path, robot, kind=look.kind).chunks()))


def _places(robot: Robot, q: Tensor) -> np.ndarray:
    from ikgrad.kinematics import forward_kinematics

    return forward_kinematics(robot.detach(), q)[:, :3, 3].numpy()


FAMILY = Family("a joint file", find)
