"""How fast points of an arm can be: for each joint, a bound on the distance of every link from its axis.

A point at distance rho from the axis of a joint that turns at qd moves by at most rho |qd|, whatever the other joints
do; along a slide it moves by |qd|. The distance of a point from the axis of joint k never exceeds

    |part of the first hop across the axis| + the lengths of all later hops + the strokes of the slides between,

where the hops are the fixed vectors from joint to joint and at last to the point. A point that rides on the joint's
own link has the first hop alone, and the bound is its distance itself.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision.links import link_layout
from ikgrad.robot import Robot


class Reach(NamedTuple):
    """Bounds for both ends of all L segments of `link_segments`, first ends first, against the m moving joints."""

    arm: Tensor  # (2 L, m) distance from the axis of a turning joint without strokes, 1 for a slide, 0 if unmoved
    strokes: Tensor  # (2 L, m, m) ones where the stroke of the last index adds to it
    joints: Robot

    def speed(self, qd: Tensor, q: Tensor) -> Tensor:
        """(M, L) bound on the speed of every point of every segment [m/s].

        Args:
            qd: (M, n) bounds on the joint speeds.
            q: (M, n) bounds on the absolute joint values; only those of slides matter.
        """
        tables = self.joints.tables(device=qd.device)
        rate = (tables.multiplier.abs() * qd[:, tables.variable])[:, None]  # (M, 1, m)
        arm = self.arm.expand(len(qd), -1, -1)
        if bool(tables.prismatic.any()):
            value = tables.multiplier.abs() * q[:, tables.variable] + tables.offset.abs()
            stroke = torch.where(tables.prismatic, value, 0.0)  # (M, m)
            arm = arm + (self.strokes @ stroke[:, None, :, None])[..., 0]
        speed = (arm * rate).sum(dim=-1)  # (M, 2 L)
        first, second = speed.chunk(2, dim=-1)
        return torch.maximum(first, second)  # in between, velocities mix linearly


def link_reach(robot: Robot) -> Reach:
    """The bounds for a robot, in float64 on its device.

    Example:
        >>> import ikgrad as ik
        >>> from ikgrad.collision.reach import link_reach
        >>> link_reach(ik.load_robot("arm4")).arm[-1]
        tensor([30., 30., 20., 10.], dtype=torch.float64)
    """
    tables, layout = robot.detach().tables(), link_layout(robot)
    count = len(tables.axes)
    ends = torch.cat([layout.start, layout.end])
    arm = torch.zeros(len(ends), count, dtype=torch.float64)
    strokes = torch.zeros(len(ends), count, count, dtype=torch.float64)
    hops = tables.origins[:, :3, 3]
    for i, link in enumerate(ends.tolist()):
        last = int(tables.link_frame[link])  # moving frames 1 ... last carry the point
        way = [*hops[1:last], tables.link_offset[link, :3, 3]]  # way[k]: from joint k to the next, or to the point
        for k in range(last):
            if tables.prismatic[k]:
                arm[i, k] = 1.0
                continue
            across = torch.linalg.cross(tables.axes[k], way[k]).norm()
            arm[i, k] = across + sum(hop.norm() for hop in way[k + 1 :])
            strokes[i, k, k + 1 : last] = tables.prismatic[k + 1 : last].double()
    return Reach(arm.to(robot.device), strokes.to(robot.device), robot.detach())
