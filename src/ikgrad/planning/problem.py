"""What a path costs: clearance, joint limits and smoothness, with the Gauss-Newton matrix that belongs to it.

For the free vias x of one row, samples q_s = (W points)_s and N of them,

    F(x) = 1/(2N) sum_s r_s^2 + 1/(2N) sum_s |o_s|^2 + lambda/2 points^T K points

    r_s = |max(0, target - distance)| / length     over all links and obstacles at the sample
    o_s = what lies outside the joint limits       in rad, slides divided by the arm's length

r_s is one number a sample, so one call of autograd gives all its slopes g_s = dr_s/dq_s, and the chain rule through
the curve is a product with W. The target is a little more than the margin that is asked for, and the limits a little
narrower: a penalty that is balanced against smoothness stops short of what it wants.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision import link_segments
from ikgrad.collision.distance import safe_norm
from ikgrad.collision.obstacles import Obstacles
from ikgrad.planning.curve import Curve, aligned, each
from ikgrad.robot import Robot

_BUFFER = 0.01  # of the arm's length, on top of the margin
_INSET = 0.01  # of a joint's range


class Model(NamedTuple):
    """Cost, gradient and Gauss-Newton matrix at the vias of B rows.

    v vias of n joints are v n variables; c of them with zeros behind, up to a multiple of eight (see `curve.aligned`).
    """

    cost: Tensor  # (B,)
    gradient: Tensor  # (B, c)
    curvature: Tensor  # (B, c, c), without smoothness


class Problem(NamedTuple):
    """B pairs of ends in one scene, float64."""

    robot: Robot
    obstacles: Obstacles
    link_radius: Tensor | float
    margin: float
    curve: Curve
    start: Tensor  # (B, n)
    goal: Tensor  # (B, n)
    low: Tensor  # (B, n) what the samples shall keep
    high: Tensor  # (B, n)
    unit: Tensor  # (n,) 1, or 1 / length for slides
    smoothness: float  # lambda

    def rows(self, index: Tensor) -> Problem:
        """Some of the rows."""
        parts = {name: getattr(self, name)[index] for name in ("start", "goal", "low", "high")}
        return self._replace(**parts)

    def points(self, vias: Tensor) -> Tensor:
        """(B, v, n) -> (B, v + 2, n), with the ends."""
        return torch.cat([self.start[:, None], vias, self.goal[:, None]], dim=1)

    def intrusion(self, q: Tensor) -> Tensor:
        """(..., n) -> (...) r: how far all links together come into the target around all obstacles, per arm length."""
        distance = self.obstacles.distance(link_segments(self.robot, q), self.link_radius)
        target = self.margin + _BUFFER * self.robot.length
        return safe_norm((target - distance).clamp(min=0.0).flatten(-2)) / self.robot.length

    def cost(self, vias: Tensor) -> Tensor:
        """(B,) F."""
        points = self.points(vias)
        q = self.curve.at_samples(points)
        return self._cost(points, self.intrusion(q), self._outside(q))

    def model(self, vias: Tensor) -> Model:
        """F with its derivatives."""
        points, W = self.points(vias), self.curve.samples[:, 1:-1]
        with torch.enable_grad():
            q = self.curve.at_samples(points).requires_grad_()
            r = self.intrusion(q)  # (B, N)
            (slope,) = torch.autograd.grad(r.sum(), q)  # (B, N, n)
        q, r = q.detach(), r.detach()
        outside, count = self._outside(q), q.shape[1]
        pull = (slope * r[..., None] + outside * self.unit) / count
        smooth = each(self.curve.jerk, points)[:, 1:-1] * self.unit.square()
        gradient = each(W.mT, pull) + self.smoothness * smooth
        rows = aligned((W[:, :, None] * slope[:, :, None, :]).flatten(2))  # (B, N, c): dr_s/dx
        curvature = rows.mT.bmm(rows) / count
        self._add_limits(curvature, outside)
        return Model(self._cost(points, r, outside), aligned(gradient.flatten(1)), curvature)

    def metric(self) -> Tensor:
        """(c, c) lambda K: the curvature of the smoothness, and of variables that do nothing."""
        free = self.curve.jerk[1:-1, 1:-1].contiguous()
        full = torch.kron(free, self.unit.square().diag())
        return self.smoothness * torch.block_diag(full, torch.eye(-len(full) % 8).to(full))

    def _cost(self, points: Tensor, r: Tensor, outside: Tensor) -> Tensor:
        bend = (points * each(self.curve.jerk, points) * self.unit.square()).flatten(1).sum(dim=1)
        hurt = r.square().sum(dim=1) + outside.square().flatten(1).sum(dim=1)
        return (hurt / r.shape[1] + self.smoothness * bend) / 2

    def _outside(self, q: Tensor) -> Tensor:
        """(B, N, n) o: positive above the upper limit, negative below the lower."""
        above, below = (q - self.high[:, None]).clamp(min=0.0), (self.low[:, None] - q).clamp(min=0.0)
        return (above - below) * self.unit

    def _add_limits(self, curvature: Tensor, outside: Tensor) -> None:
        """Adds the Gauss-Newton matrix of o, which couples each joint with itself alone."""
        W = self.curve.samples[:, 1:-1]
        v, n = W.shape[1], outside.shape[2]
        active = (outside != 0) * self.unit.square() / len(W)  # (B, N, n)
        pairs = (W[:, :, None] * W[:, None, :]).flatten(1)  # (N, v v)
        blocks = each(pairs.mT, active).unflatten(1, (v, v))  # (B, v, v, n)
        joints = curvature[:, : v * n, : v * n].unflatten(2, (v, n)).unflatten(1, (v, n))  # (B, v, n, v, n)
        joints.diagonal(dim1=2, dim2=4).add_(blocks)


def make_problem(
    robot: Robot,
    obstacles: Obstacles,
    curve: Curve,
    start: Tensor,
    goal: Tensor,
    margin: float,
    link_radius: Tensor | float,
    smoothness: float,
) -> Problem:
    """The problem for starts and goals (B, n), float64."""
    q_min, q_max = (x.to(start) for x in (robot.q_min, robot.q_max))
    inset = _INSET * (q_max - q_min)
    inset = inset.where(inset.isfinite(), 0.0)
    low = torch.minimum(q_min + inset, torch.minimum(start, goal))  # ends may lie at the limits themselves
    high = torch.maximum(q_max - inset, torch.maximum(start, goal))
    unit = torch.where(robot.revolute.to(start.device), 1.0, 1 / robot.length).to(start)
    return Problem(robot, obstacles, link_radius, margin, curve, start, goal, low, high, unit, smoothness)
