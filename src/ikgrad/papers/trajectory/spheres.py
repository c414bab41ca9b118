"""The sphere test on random segments: corrected and as printed, against the exact distance."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.collision import link_sphere_intersection, sphere_link_distance

CHUNK = 250_000  # rows in memory at a time


@dataclass(frozen=True)
class SphereTest:
    """Segments and spheres in pairs.

    Attributes:
        segments: pairs.
        touching: segments that meet their sphere, by the exact distance.
        wrong: segments whose corrected verdict differs from it.
        lines: infinite lines that meet their sphere, by the distance of the centre from the line.
        lines_wrong: corrected discriminants that differ from it.
        lines_wrong_printed: printed discriminants, B^2 >= 4 A C, that do.
        heights_wrong: segments misjudged when a root counts as on the link where z_p <= z <= z_q, as printed.
    """

    segments: int
    touching: int
    wrong: int
    lines: int
    lines_wrong: int
    lines_wrong_printed: int
    heights_wrong: int


def sphere_test(segments: int, *, seed: int = 0) -> SphereTest:
    """One random segment and sphere a row: ends and centre in [-1, 1]^3, radius 0.05 to 1.05.

    Example:
        >>> test = sphere_test(1000)
        >>> test.wrong, test.lines_wrong
        (0, 0)
    """
    generator = torch.Generator().manual_seed(seed)
    counts = torch.zeros(6, dtype=torch.int64)
    for begin in range(0, segments, CHUNK):
        rows = min(CHUNK, segments - begin)
        x = 2 * torch.rand(rows, 3, 3, dtype=torch.float64, generator=generator) - 1
        radii = 0.05 + torch.rand(rows, 1, dtype=torch.float64, generator=generator)
        counts += _count(x[:, None, :2], x[:, 2:], radii)
    return SphereTest(segments, *counts.tolist())


def line_distance(links: Tensor, centers: Tensor) -> Tensor:
    """(N, 1, 1) distance of a centre from the infinite line, |d x (o - p)| / |d|.

    Args:
        links: (N, 1, 2, 3)
        centers: (N, 1, 3)
    """
    p, q = links.unbind(-2)
    across = torch.linalg.cross(q - p, centers - p, dim=-1).norm(dim=-1)
    return (across / (q - p).norm(dim=-1))[..., None]


def heights_meet(links: Tensor, enter: Tensor, leave: Tensor) -> Tensor:
    """(N, 1, K) whether a root lies at a height z_p <= z <= z_q, the printed extent of a link."""
    low, high = links[..., 0, 2, None], links[..., 1, 2, None]
    heights = (low + zeta * (high - low) for zeta in (enter, leave))
    on = [(low <= z) & (z <= high) for z in heights]
    return on[0] | on[1]


def _count(links: Tensor, centers: Tensor, radii: Tensor) -> Tensor:
    found = link_sphere_intersection(links, centers, radii)
    printed = link_sphere_intersection(links, centers, radii, literal=True)
    touching = sphere_link_distance(links, centers, radii) <= 0
    line = line_distance(links, centers) <= radii[:, None]
    heights = heights_meet(links, found.enter, found.leave)
    verdicts = [
        touching,
        found.link_meets != touching,
        line,
        found.line_meets != line,
        printed.line_meets != line,
        heights != touching,
    ]
    return torch.stack([verdict.sum() for verdict in verdicts])


__all__ = ["SphereTest", "heights_meet", "line_distance", "sphere_test"]
