"""A robot's links as segments from link origin to link origin."""

from __future__ import annotations

import weakref
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ikgrad.kinematics import check_q, link_poses, takes_kernels
from ikgrad.robot import Robot


class Layout(NamedTuple):
    """Which links of ``robot.link_names`` the segments connect."""

    start: Tensor  # (L,) int64
    end: Tensor  # (L,)


_layouts: weakref.WeakKeyDictionary[Robot, Layout] = weakref.WeakKeyDictionary()
_points: weakref.WeakKeyDictionary[Robot, Any] = weakref.WeakKeyDictionary()


def link_segments(robot: Robot, q: Tensor) -> Tensor:
    """The links of the arm as segments in the base: from the origin of each link to that of the next, tool included.

    Segments that have no length in any configuration (two joints that share a centre, as in a wrist) are left out;
    `link_pairs` names the others. A link's origin is that of the joint that moves it, so these are the straight
    lines between successive joints. Denavit-Hartenberg rows with both a and d give the straight line, not the corner.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) joint values [rad or m].

    Returns:
        (..., L, 2, 3) both ends of every segment [m], differentiable.

    Raises:
        ShapeError: ``q`` does not end in n floating-point values.

    Example:
        >>> import ikgrad as ik, torch
        >>> from ikgrad.collision import link_segments
        >>> robot = ik.load_robot("panda")
        >>> links = link_segments(robot, torch.zeros(5, 7))
        >>> links.shape, (links[0, :, 1] - links[0, :, 0]).norm(dim=-1)
        (torch.Size([5, 6, 2, 3]), tensor([0.3330, 0.3160, 0.0825, 0.3928, 0.0880, 0.1070]))
    """
    check_q(robot, q)
    if takes_kernels(robot, q):
        return _Segments.apply(q, robot) if q.requires_grad and torch.is_grad_enabled() else _compiled(robot, q)
    return plain_link_segments(robot, q)


def plain_link_segments(robot: Robot, q: Tensor) -> Tensor:
    """`link_segments` in torch operations alone."""
    layout = link_layout(robot)
    origins = link_poses(robot, q)[..., :3, 3]  # (..., links, 3)
    ends = torch.stack([layout.start, layout.end], dim=-1).to(q.device)
    return origins[..., ends, :]


def link_pairs(robot: Robot) -> tuple[tuple[str, str], ...]:
    """Names of the links at both ends of every segment of `link_segments`.

    Example:
        >>> import ikgrad as ik
        >>> from ikgrad.collision import link_pairs
        >>> link_pairs(ik.load_robot("arm4"))[-1]
        ('link_4', 'hand')
    """
    layout = link_layout(robot)
    names = robot.link_names
    return tuple((names[i], names[j]) for i, j in zip(layout.start.tolist(), layout.end.tolist(), strict=True))


def link_layout(robot: Robot) -> Layout:
    """Segments between successive links that can have a length (kept as long as the robot lives)."""
    layout = _layouts.get(robot)
    if layout is None:
        tables = robot.detach().tables()
        where = link_poses(robot.detach(), torch.zeros(robot.dof, dtype=torch.float64))[:, :3, 3]
        apart = (where[1:] - where[:-1]).norm(dim=-1) > 1e-9
        slides = torch.cat([torch.zeros(1, dtype=torch.int64), tables.prismatic.long().cumsum(0)])
        slid = slides[tables.link_frame]  # slides before each link
        kept = torch.nonzero(apart | (slid[1:] != slid[:-1])).flatten()
        layout = _layouts[robot] = Layout(kept, kept + 1)
    return layout


def _packed(robot: Robot) -> tuple[Any, Any]:
    """The chain and both ends of all segments for the kernels."""
    from ikgrad import engine
    from ikgrad.engine.links import pack_points

    chain = engine.pack(robot)
    carried = _points.get(robot)
    if carried is None:
        layout = link_layout(robot)
        ends = torch.stack([layout.start, layout.end], dim=-1).flatten()
        zero = torch.zeros(robot.dof, dtype=torch.float64)
        at_zero = link_poses(robot, zero)[ends, :3, 3].numpy()
        carried = _points[robot] = pack_points(chain, robot.tables().link_frame[ends].numpy(), at_zero)
    return chain, carried


def _compiled(robot: Robot, q: Tensor) -> Tensor:
    from ikgrad.engine.links import points

    chain, carried = _packed(robot)
    where = points(chain, carried, q.detach().reshape(-1, robot.dof).numpy(), threads=torch.get_num_threads())
    return torch.from_numpy(where).view(*q.shape[:-1], where.shape[1] // 2, 2, 3)


class _Segments(torch.autograd.Function):
    """The kernel, with the one-pass vector-Jacobian product of `engine.links` as its backward."""

    @staticmethod
    def forward(ctx: Any, q: Tensor, robot: Robot) -> Tensor:
        ctx.save_for_backward(q)
        ctx.robot = robot
        return _compiled(robot, q)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        from ikgrad.engine.links import points_vjp

        (q,), (grad,) = ctx.saved_tensors, grads
        if torch.is_grad_enabled():  # somebody differentiates twice: torch operations all the way
            return torch.autograd.grad(plain_link_segments(ctx.robot, q), q, grad, create_graph=True)[0], None
        chain, carried = _packed(ctx.robot)
        rows, g = q.reshape(-1, ctx.robot.dof).numpy(), grad.reshape(q.shape[:-1].numel(), -1, 3).numpy()
        pulled = points_vjp(chain, carried, rows, g, threads=torch.get_num_threads())
        return torch.from_numpy(pulled).view(q.shape), None
