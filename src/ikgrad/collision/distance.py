"""Exact signed distances between links and obstacles.

The nearest point of a segment p, q to a point o is p + t (q - p) with

    t = clamp((o - p).(q - p) / |q - p|^2, 0, 1),

and everything else follows from the vector v from there to o. Differences of coordinates are formed first, so nothing
cancels: the error is a few units in the last place of the largest coordinate. (Expanding |p - o|^2 into
p.p - 2 p.o + o.o for a matrix product loses half of the digits near contact.)

Float tensors on the CPU go through the compiled kernels of `ikgrad.engine.spheres`; everything else (CUDA, second
derivatives, gradients with respect to obstacles, transforms) through the torch code here, their oracle.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ikgrad.collision.checks import check_link_radius, check_links, check_spheres
from ikgrad.errors import ShapeError
from ikgrad.kinematics import no_transform


def sphere_link_distance(links: Tensor, centers: Tensor, radii: Tensor, *, link_radius: Tensor | float = 0.0) -> Tensor:
    """Signed distance between the surfaces of every link and every sphere.

        |o - (p + t (q - p))| - r - r_link,   t = clamp((o - p).(q - p) / |q - p|^2, 0, 1)

    Negative where they overlap. Batch dimensions broadcast, so spheres may differ from configuration to configuration.
    Differentiable with respect to everything, twice wherever the nearest point does not switch between an end and
    the inside; once everywhere but where a centre lies on the segment, and zero there. A link no longer than
    the rounding of 1 m is a point.

    Args:
        links: (..., L, 2, 3) both ends of every link [m], from `link_segments` for example.
        centers: (..., K, 3) centres of the spheres [m].
        radii: (..., K) their radii [m].
        link_radius: radius of the links as capsules [m], one for all or (L,).

    Returns:
        (..., L, K) [m]; float32 tensors on the CPU are computed in float64 and rounded once.

    Raises:
        ShapeError: a shape or dtype does not fit, or there are no spheres.
        ConfigError: something is not finite, or a radius not positive; the message says which entry.

    Source:
        The distance behind the link-sphere test of Ang et al. 2014; see `link_sphere_intersection`.

    Example:
        >>> import ikgrad as ik, torch
        >>> link = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]])
        >>> ball = torch.tensor([[0.5, 0.3, 0.0], [2.0, 0.0, 0.0]])
        >>> ik.sphere_link_distance(link, ball, torch.tensor([0.1, 0.1]), link_radius=0.05)
        tensor([[0.1500, 0.8500]])
    """
    check_links(links)
    check_spheres(centers, radii)
    check_link_radius(link_radius, links.shape[-3])
    for name, value in (("centers", centers), ("radii", radii)):
        if value.dtype != links.dtype or value.device != links.device:
            raise ShapeError(
                f"{name} must have the dtype and device of links, {links.dtype} on {links.device}, "
                f"got {value.dtype} on {value.device}"
            )
    return distance(links, centers, radii, link_radius)


def distance(links: Tensor, centers: Tensor, radii: Tensor, link_radius: Tensor | float) -> Tensor:
    """`sphere_link_distance` without the checks."""
    thickness = torch.as_tensor(link_radius, dtype=links.dtype, device=links.device)
    if _takes_kernel(links, centers, radii, thickness):
        return _Distance.apply(links.double(), centers.double(), radii.double(), thickness.double()).to(links.dtype)
    return plain_distance(links, centers, radii, thickness)


def plain_distance(links: Tensor, centers: Tensor, radii: Tensor, link_radius: Tensor) -> Tensor:
    """`distance` in torch operations alone."""
    ends = links[..., :, None, :, :]  # (..., L, 1, 2, 3)
    v = from_segment(centers[..., None, :, :], ends[..., 0, :], ends[..., 1, :])  # (..., L, K, 3)
    return safe_norm(v) - radii[..., None, :] - link_radius[..., None]


def from_segment(x: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """(..., 3) vector from the nearest point of the segment a, b to x; all (..., 3), broadcast."""
    d, w = b - a, x - a
    square = (d * d).sum(dim=-1)
    point = square <= torch.finfo(square.dtype).eps ** 2  # too short to have a direction
    t = (w * d).sum(dim=-1) / torch.where(point, 1.0, square)
    t = torch.where(point, 0.0, t).clamp(0.0, 1.0)
    return w - t[..., None] * d


def safe_norm(v: Tensor) -> Tensor:
    """(...) length of (..., 3), with gradient zero instead of NaN at zero."""
    square = (v * v).sum(dim=-1)
    zero = square == 0
    return torch.where(zero, 0.0, torch.where(zero, 1.0, square).sqrt())


def segment_distance(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    """(...) distance between the segments a, b and c, d, all (..., 3), broadcast.

    The least of five distances from a point to a segment: the four ends, and the point where the *lines* come
    nearest, s = ((c - a) x e).n / n.n with n = (b - a) x e and e = d - c. Each is an upper bound and one of them is
    the answer, so rounding in s (the lines may be nearly parallel) costs next to nothing.
    """
    a, b, c, d = torch.broadcast_tensors(a, b, c, d)
    e, w = d - c, c - a
    n = torch.linalg.cross(b - a, e, dim=-1)
    square = (n * n).sum(dim=-1)
    parallel = square <= torch.finfo(square.dtype).eps ** 4
    s = (torch.linalg.cross(w, e, dim=-1) * n).sum(dim=-1) / torch.where(parallel, 1.0, square)
    s = torch.where(parallel, 0.0, s).clamp(0.0, 1.0)
    candidates = [
        from_segment(a + s[..., None] * (b - a), c, d),
        from_segment(a, c, d),
        from_segment(b, c, d),
        from_segment(c, a, b),
        from_segment(d, a, b),
    ]
    return torch.stack([safe_norm(v) for v in candidates], dim=-1).amin(dim=-1)


def _takes_kernel(links: Tensor, centers: Tensor, radii: Tensor, link_radius: Tensor) -> bool:
    """True if the kernel can serve: on the CPU, spheres shared by all rows, gradients to the links alone."""
    obstacles_move = torch.is_grad_enabled() and any(x.requires_grad for x in (centers, radii, link_radius))
    shared = centers.ndim == 2 and radii.ndim == 1 and link_radius.ndim <= 1
    precise = links.dtype in (torch.float32, torch.float64)
    return precise and links.device.type == "cpu" and shared and not obstacles_move and no_transform()


class _Distance(torch.autograd.Function):
    """The kernel, with the one-pass vector-Jacobian product of `engine.spheres` as its backward."""

    @staticmethod
    def forward(ctx: Any, links: Tensor, centers: Tensor, radii: Tensor, link_radius: Tensor) -> Tensor:
        from ikgrad.engine.spheres import distances

        ctx.save_for_backward(links, centers, radii, link_radius)
        rows, thickness = links.detach().reshape(-1, 2, 3), link_radius.expand(links.shape[-3])
        arrays = (x.detach().numpy() for x in (rows, centers, radii, thickness))
        out = distances(*arrays, threads=torch.get_num_threads())
        return torch.from_numpy(out).view(*links.shape[:-2], len(radii))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None]:
        from ikgrad.engine.spheres import distances_vjp

        (links, centers, radii, link_radius), (grad,) = ctx.saved_tensors, grads
        if torch.is_grad_enabled():  # somebody differentiates twice: torch operations all the way
            out = plain_distance(links, centers, radii, link_radius)
            return torch.autograd.grad(out, links, grad, create_graph=True)[0], None, None, None
        rows, g = links.reshape(-1, 2, 3).numpy(), grad.reshape(-1, len(radii)).numpy()
        pulled = distances_vjp(rows, centers.numpy(), g, threads=torch.get_num_threads())
        return torch.from_numpy(pulled).view(links.shape), None, None, None
