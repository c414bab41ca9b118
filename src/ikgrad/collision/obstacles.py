"""Obstacles, checked once when they are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from ikgrad.collision.checks import check_finite, check_radii, check_spheres, check_tensor
from ikgrad.collision.distance import distance, segment_distance


@dataclass(frozen=True, eq=False)
class Spheres:
    """K spheres.

    Args:
        centers: (..., K, 3) [m]
        radii: (..., K) [m]

    Raises:
        ShapeError: a shape does not fit, or there are none.
        ConfigError: something is not finite, or a radius not positive; the message says which entry.

    Example:
        >>> import torch
        >>> from ikgrad.collision import Spheres
        >>> Spheres(torch.zeros(2, 3), torch.tensor([0.1, 0.0]))
        Traceback (most recent call last):
        ikgrad.errors.ConfigError: radii must be positive, but radii[1] is 0
    """

    centers: Tensor
    radii: Tensor

    def __post_init__(self) -> None:
        check_spheres(self.centers, self.radii)

    def __len__(self) -> int:
        return self.radii.shape[-1]

    def distance(self, links: Tensor, link_radius: Tensor | float = 0.0) -> Tensor:
        """(..., L, K) signed distances [m] to links (..., L, 2, 3), which are not checked again."""
        return distance(links, self.centers.to(links), self.radii.to(links), link_radius)


@dataclass(frozen=True, eq=False)
class Capsules:
    """K capsules: all points within a radius of a segment. A segment without length makes a sphere.

    Args:
        ends: (..., K, 2, 3) both ends of every axis [m].
        radii: (..., K) [m]

    Raises:
        ShapeError: a shape does not fit, or there are none.
        ConfigError: something is not finite, or a radius not positive; the message says which entry.

    Example:
        >>> import torch
        >>> from ikgrad.collision import Capsules
        >>> pole = Capsules(torch.tensor([[[0.0, 0, -1], [0, 0, 1]]]), torch.tensor([0.1]))
        >>> pole.distance(torch.tensor([[[0.5, -1, 0], [0.5, 1, 0]]]))
        tensor([[0.4000]])
    """

    ends: Tensor
    radii: Tensor

    def __post_init__(self) -> None:
        good = isinstance(self.ends, Tensor) and self.ends.ndim >= 3 and self.ends.shape[-2:] == (2, 3)
        check_tensor("ends", self.ends, "(..., K, 2, 3)", good)
        check_radii(self.radii, self.ends.shape[-3], "ends", self.ends)
        check_finite("ends", self.ends)

    def __len__(self) -> int:
        return self.radii.shape[-1]

    def distance(self, links: Tensor, link_radius: Tensor | float = 0.0) -> Tensor:
        """(..., L, K) signed distances [m] to links (..., L, 2, 3), which are not checked again."""
        a, b = links[..., :, None, :, :].unbind(dim=-2)  # (..., L, 1, 3)
        c, d = self.ends.to(links)[..., None, :, :, :].unbind(dim=-2)  # (..., 1, K, 3)
        thickness = torch.as_tensor(link_radius, dtype=links.dtype, device=links.device)
        return segment_distance(a, b, c, d) - self.radii.to(links)[..., None, :] - thickness[..., None]


Obstacles: TypeAlias = Spheres | Capsules
