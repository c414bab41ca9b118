"""The poses that solvers are asked for. Each set is a pure function of the robot, a number of rows and a seed."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.data import sample_configurations
from ikgrad.data.paths import clear_paths, smooth_paths
from ikgrad.errors import RobotError
from ikgrad.kinematics import forward_kinematics, pose_and_jacobian
from ikgrad.robot import Robot

SINGULAR = 1e-3  # below this smallest singular value of the Jacobian [m or 1, base frame] a row counts as singular
_NEWTON_STEPS = 40
_ROUNDS = 40


def reachable(robot: Robot, rows: int, seed: int) -> Tensor:
    """(rows, 4, 4) poses of configurations drawn uniformly inside the limits."""
    return forward_kinematics(robot, sample_configurations(robot, rows, seed=seed))


def singular(robot: Robot, rows: int, seed: int) -> Tensor:
    """(rows, 4, 4) poses of configurations inside the limits whose smallest singular value is below 1e-3."""
    return forward_kinematics(robot, singular_configurations(robot, rows, seed))


def singular_configurations(robot: Robot, rows: int, seed: int) -> Tensor:
    """(rows, n) random configurations driven to a singularity by Newton steps on the smallest singular value.

    The value s that a row is driven to is drawn from 1e-6 to 1e-3, evenly in its logarithm. With J v = s u the
    derivative of s is u^T (dJ/dq) v.

    Raises:
        RobotError: the robot has fewer than six joints (every configuration is singular), or too few were found.
    """
    if robot.dof < 6:
        raise RobotError(f"robot '{robot.name}' has {robot.dof} joints: its Jacobian is singular everywhere")
    found = torch.empty(0, robot.dof, dtype=torch.float64)
    for attempt in range(_ROUNDS):
        q = sample_configurations(robot, max(rows, 64), seed=seed * _ROUNDS + attempt)
        generator = torch.Generator().manual_seed(seed * _ROUNDS + attempt)
        wanted = 10 ** -(3 + 3 * torch.rand(len(q), dtype=torch.float64, generator=generator))
        q = _drive(robot, q, wanted)
        found = torch.cat([found, q[smallest_singular_value(robot, q) < SINGULAR]])
        if len(found) >= rows:
            return found[:rows]
    raise RobotError(f"found only {len(found)} of {rows} singular configurations of robot '{robot.name}'")


def smallest_singular_value(robot: Robot, q: Tensor) -> Tensor:
    """(B,) of the geometric Jacobian."""
    return torch.linalg.svdvals(pose_and_jacobian(robot, q)[1])[:, -1]


def _drive(robot: Robot, q: Tensor, wanted: Tensor) -> Tensor:
    for _ in range(_NEWTON_STEPS):
        q = q.detach().requires_grad_()
        J = pose_and_jacobian(robot, q)[1]
        U, s, Vh = torch.linalg.svd(J.detach(), full_matrices=False)
        value = torch.einsum("bi,bij,bj->b", U[..., -1], J, Vh[:, -1])  # equals s[:, -1], and can be differentiated
        (slope,) = torch.autograd.grad(value.sum(), q)
        step = (s[:, -1] - wanted)[:, None] * slope / slope.square().sum(dim=-1, keepdim=True).clamp_min(1e-12)
        step = torch.where((s[:, -1] < SINGULAR)[:, None], 0.0, step.clamp(-0.3, 0.3))
        q = (q.detach() - step).clamp(robot.q_min, robot.q_max)
    return q


def unreachable(robot: Robot, rows: int, seed: int) -> Tensor:
    """(rows, 4, 4) poses 0.2 m to 2 m outside the ball around the first joint that holds the whole workspace.

    Raises:
        RobotError: the robot has an unlimited slide.
    """
    if not math.isfinite(robot.reach_bound):
        raise RobotError(f"robot '{robot.name}' has an unlimited slide: nothing is out of its reach")
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(rows, 3, dtype=torch.float64, generator=generator)
    outside = 0.2 + 1.8 * torch.rand(rows, 1, dtype=torch.float64, generator=generator)
    T = reachable(robot, rows, seed)  # for their rotations
    shoulder = robot.tables().origins[0, :3, 3]
    T[:, :3, 3] = shoulder + (workspace_radius(robot) + outside) * direction / direction.norm(dim=-1, keepdim=True)
    return T


def workspace_radius(robot: Robot) -> float:
    """Greatest distance of the tip from the first joint's origin [m]: ascent from the best of many samples.

    `Robot.reach_bound` is larger than this, and a solver may use it as a certificate: that would make the poses easy.
    """
    shoulder = robot.tables().origins[0, :3, 3]
    q = sample_configurations(robot, 50_000, seed=0)
    distance = (forward_kinematics(robot, q)[:, :3, 3] - shoulder).norm(dim=-1)
    q = q[distance.topk(32).indices]
    best, size = float(distance.max()), 0.1
    for _ in range(300):
        q = q.detach().requires_grad_()
        distance = (forward_kinematics(robot, q)[:, :3, 3] - shoulder).norm(dim=-1)
        best = max(best, float(distance.detach().max()))
        (slope,) = torch.autograd.grad(distance.sum(), q)
        q = (q.detach() + size * slope).clamp(robot.q_min, robot.q_max)
        size *= 0.99
    return best


__all__ = [
    "SINGULAR",
    "clear_paths",
    "reachable",
    "singular",
    "singular_configurations",
    "smallest_singular_value",
    "smooth_paths",
    "unreachable",
    "workspace_radius",
]
