"""Where a link's line enters and leaves a sphere: the quadratic of the trajectory paper, corrected."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision.checks import check_link_radius, check_links, check_spheres


class Intersection(NamedTuple):
    """Parameters on the lines through L links, measured from the first end (0) to the second (1)."""

    enter: Tensor  # (..., L, K) smaller root, NaN where the line misses the sphere
    leave: Tensor  # (..., L, K) larger root
    line_meets: Tensor  # (..., L, K) bool, the infinite line meets the sphere
    link_meets: Tensor  # (..., L, K) bool, the link itself does


def link_sphere_intersection(
    links: Tensor, centers: Tensor, radii: Tensor, *, link_radius: Tensor | float = 0.0, literal: bool = False
) -> Intersection:
    """Parameters zeta at which the line p + zeta (q - p) crosses the surface of a sphere with centre o and radius r.

        A zeta^2 + 2 B zeta + C = 0,   A = d.d,  B = d.(p - o),  C = |p - o|^2 - r^2,  d = q - p
        real if B^2 >= A C,            zeta = (-B -+ sqrt(B^2 - A C)) / A

    The link meets the sphere if a root lies in [0, 1], or if both ends are inside. The discriminant is computed as
    A r^2 - |d x (p - o)|^2, its equal by Lagrange's identity, in which no squares of distances cancel.
    Roots are differentiable where the line crosses the surface. A link without length has no roots, and meets the
    sphere if it lies inside. With ``link_radius`` r grows by it, which is the same question for a capsule.

    Differences:
        The paper prints B^2 >= 4 A C, a slip from the formula for A x^2 + B x + C; ``literal=True`` uses it. It also
        bounds a link by the heights z of its ends, which decides nothing for level links; here it is 0 <= zeta <= 1.

    Args:
        links: (..., L, 2, 3) both ends of every link [m].
        centers: (..., K, 3) [m]
        radii: (..., K) [m]
        link_radius: radius of the links as capsules [m], one for all or (L,).
        literal: the printed discriminant. Where it alone claims that a line meets, the roots are NaN.

    Raises:
        ShapeError: a shape or dtype does not fit, or there are no spheres.
        ConfigError: something is not finite, or a radius not positive; the message says which entry.

    Source:
        Ang, Tang, Mashohor, Ariffin 2014, the equations before Table 1.

    Example:
        >>> import torch
        >>> from ikgrad.collision import link_sphere_intersection
        >>> link = torch.tensor([[[0.0, 0, 0], [2, 0, 0]]])
        >>> hit = link_sphere_intersection(link, torch.tensor([[1.0, 0, 0]]), torch.tensor([0.5]))
        >>> hit.enter.item(), hit.leave.item(), hit.link_meets.item()
        (0.25, 0.75, True)
    """
    check_links(links)
    check_spheres(centers, radii)
    check_link_radius(link_radius, links.shape[-3])
    p, q = links[..., :, None, :, :].unbind(dim=-2)  # (..., L, 1, 3)
    d, w = q - p, p - centers[..., None, :, :]  # (..., L, 1, 3), (..., L, K, 3)
    r = radii[..., None, :] + torch.as_tensor(link_radius).to(links)[..., None]
    A, B = (d * d).sum(dim=-1), (d * w).sum(dim=-1)
    distance_p, distance_q = w.norm(dim=-1), (w + d).norm(dim=-1)
    C = (distance_p - r) * (distance_p + r)
    quarter = A * r * r - torch.linalg.cross(d.expand_as(w), w).square().sum(dim=-1)  # B^2 - A C
    point = A.le(torch.finfo(A.dtype).eps ** 2)
    crosses = (quarter >= 0) & ~point
    enter, leave = _roots(torch.where(point, 1.0, A), B, C, torch.where(crosses, quarter, 1.0))
    on_link = crosses & (((enter >= 0) & (enter <= 1)) | ((leave >= 0) & (leave <= 1)))
    inside = (distance_p <= r) & (distance_q <= r)
    if literal:
        crosses = (B * B >= 4 * A * C) & ~point
        on_link = on_link & crosses
    missed = torch.where(crosses & (quarter >= 0), 0.0, torch.nan)
    return Intersection(enter + missed, leave + missed, crosses, on_link | inside)


def _roots(A: Tensor, B: Tensor, C: Tensor, quarter: Tensor) -> tuple[Tensor, Tensor]:
    """Roots of A x^2 + 2 B x + C, the smaller first, without cancellation: one by the formula, one from their product.

    x_1 x_2 = C / A, so with h = -B -+ sqrt(quarter), the sign that adds up, the roots are h / A and C / h.
    """
    touching = quarter == 0
    root = torch.where(touching, 0.0, torch.where(touching, 1.0, quarter).sqrt())
    h = torch.where(B > 0, -B - root, -B + root)
    large = h / A
    zero = h == 0  # then B = quarter = 0: a double root at the first end
    small = torch.where(zero, 0.0, C / torch.where(zero, 1.0, h))
    return torch.where(B > 0, large, small), torch.where(B > 0, small, large)
