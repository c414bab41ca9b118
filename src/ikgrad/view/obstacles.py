"""Spheres in the way of the arm, and how far it is from them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.view.shapes import Part, segments


class Clearance(NamedTuple):
    """The nearest pair.

    Attributes:
        distance: between the surfaces of the drawn arm and of the nearest sphere [m]; negative where they overlap.
        sphere: its index.
        words: the same for people.
    """

    distance: float
    sphere: int
    words: str


def clearance(parts: tuple[Part, ...], poses: Tensor, spheres: Spheres) -> Clearance:
    """How far the arm, as it is drawn, is from the nearest sphere.

    A joint's cylinder counts as a capsule, which is a little longer than what is drawn. The first part stands on the
    floor and counts as well.

    Args:
        parts: of `ikgrad.view.shapes.arm_parts`.
        poses: (links, 4, 4) of `ikgrad.link_poses`.
        spheres: at least one.
    """
    radii = torch.tensor([part.radius for part in parts]).to(poses)
    distances = spheres.distance(segments(parts, poses), radii)  # (parts, spheres)
    nearest = int(distances.amin(dim=0).argmin())
    least = float(distances.min())
    state = "free" if least > 0 else "contact"
    return Clearance(least, nearest, f"{state}: {1e3 * least:.0f} mm to sphere {nearest + 1}")


__all__ = ["Clearance", "clearance"]
