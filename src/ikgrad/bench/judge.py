"""One judge for everybody: forward kinematics in plain torch, float64, and the robot's limits.

What a solver says about its own answer is not looked at.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import ShapeError
from ikgrad.kinematics import plain_forward_kinematics, pose_error
from ikgrad.robot import Robot

SLACK = 1e-9  # rad or m by which a joint may exceed its limit: rounding, the same for everybody
CHUNK = 65_536  # rows judged at a time; plain forward kinematics needs a few kB for each


class Verdict(NamedTuple):
    """What the judge measured, row by row."""

    solved: Tensor  # (B,) bool: both errors within tolerance and all joints inside the limits
    position_error: Tensor  # (B,) [m], NaN where there is no answer
    rotation_error: Tensor  # (B,) [rad]
    inside: Tensor  # (B,) bool: all joints inside the limits


def judge(robot: Robot, q: Tensor, T: Tensor, *, tol_pos: float, tol_rot: float) -> Verdict:
    """Measure answers.

    Whole turns are added where they bring an angle into its range: a solver that thinks in (-pi, pi] is not punished
    for a range that lies elsewhere.

    Args:
        robot: the robot, n joint variables.
        q: (B, n) answers; rows that are not finite are no answers.
        T: (B, 4, 4) the poses that were asked for.
        tol_pos: [m]
        tol_rot: [rad]

    Raises:
        ShapeError: there is not one row of joints for every pose.
    """
    if q.shape != (len(T), robot.dof):
        raise ShapeError(f"answers must have shape {(len(T), robot.dof)}, got {tuple(q.shape)}")
    parts = [_judge(robot, *rows, tol_pos, tol_rot) for rows in zip(q.split(CHUNK), T.split(CHUNK), strict=True)]
    return Verdict(*(torch.cat(column) for column in zip(*parts, strict=True)))


def _judge(robot: Robot, q: Tensor, T: Tensor, tol_pos: float, tol_rot: float) -> Verdict:
    q = into_range(robot, q.double())
    answered = q.isfinite().all(dim=-1)
    error = pose_error(plain_forward_kinematics(robot, torch.where(answered[:, None], q, 0.0)), T)
    nan = torch.full_like(q[:, 0], math.nan)
    position = torch.where(answered, error[:, :3].norm(dim=-1), nan)
    rotation = torch.where(answered, error[:, 3:].norm(dim=-1), nan)
    inside = answered & ((q >= robot.q_min - SLACK) & (q <= robot.q_max + SLACK)).all(dim=-1)
    return Verdict((position <= tol_pos) & (rotation <= tol_rot) & inside, position, rotation, inside)


def into_range(robot: Robot, q: Tensor) -> Tensor:
    """(B, n) with whole turns added to the angles that leave their range, where some number of turns helps."""
    turn = 2 * math.pi
    low, high = robot.q_min - SLACK, robot.q_max + SLACK
    turns = torch.where(q < low, ((low - q) / turn).ceil(), ((high - q) / turn).floor())
    moved = q + turn * turns
    helps = robot.periodic & ((q < low) | (q > high)) & (moved >= low) & (moved <= high)
    return torch.where(helps, moved, q)
