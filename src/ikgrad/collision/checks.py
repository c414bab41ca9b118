"""What the functions of this package refuse, in one place: shapes always, values where they can be seen."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.kinematics import no_transform


def check_tensor(name: str, value: Tensor, shape: str, fits: bool) -> None:
    """Refuse what is no floating-point tensor of the wanted shape."""
    if not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise ShapeError(f"{name} must be a floating-point tensor, got {got}")
    if not fits:
        raise ShapeError(f"{name} must have shape {shape}, got {tuple(value.shape)}")


def check_links(links: Tensor) -> None:
    """Refuse segments that are not (..., L, 2, 3) or not finite."""
    good = isinstance(links, Tensor) and links.ndim >= 3 and links.shape[-2:] == (2, 3)
    check_tensor("links", links, "(..., L, 2, 3)", good)
    check_finite("links", links)


def check_spheres(centers: Tensor, radii: Tensor) -> None:
    """Refuse spheres that are not (..., K, 3) with (..., K) radii, finite, positive and at least one."""
    good = isinstance(centers, Tensor) and centers.ndim >= 2 and centers.shape[-1] == 3
    check_tensor("centers", centers, "(..., K, 3)", good)
    check_radii(radii, centers.shape[-2], "centers", centers)
    check_finite("centers", centers)


def check_radii(radii: Tensor, count: int, of: str, like: Tensor) -> None:
    """Refuse radii that are not (..., count), positive and finite, or belong to no obstacle at all."""
    if count == 0:
        raise ShapeError(f"there are no obstacles: {of} has shape {tuple(like.shape)}; leave the call out instead")
    good = isinstance(radii, Tensor) and radii.ndim >= 1 and radii.shape[-1] == count
    check_tensor("radii", radii, f"(..., {count}) for {of} of shape {tuple(like.shape)}", good)
    check_finite("radii", radii)
    check_bound("radii", radii, "must be positive", radii <= 0)


def check_link_radius(link_radius: Tensor | float, links: int) -> None:
    """Refuse link radii that are negative, not finite, or not one for all or one a link."""
    if isinstance(link_radius, Tensor):
        good = link_radius.ndim == 0 or link_radius.shape[-1] in (1, links)
        check_tensor("link_radius", link_radius, f"() or (..., {links})", good)
        check_finite("link_radius", link_radius)
        check_bound("link_radius", link_radius, "must not be negative", link_radius < 0)
    elif not (math.isfinite(link_radius) and link_radius >= 0):
        raise ConfigError(f"link_radius must be a finite number that is not negative, got {link_radius}")


def check_finite(name: str, value: Tensor) -> None:
    """Refuse NaN and infinities, saying where the first one is."""
    check_bound(name, value, "must be finite", ~value.isfinite())


def check_bound(name: str, value: Tensor, demand: str, bad: Tensor) -> None:
    """Refuse a tensor with bad entries, saying which is the first."""
    if no_transform() and bool(bad.any()):
        index = [int(i) for i in torch.nonzero(bad)[0]]
        entry = f"{name}[{', '.join(map(str, index))}]" if index else name
        more = int(bad.sum()) - 1
        others = f" (and {more} more)" if more else ""
        raise ConfigError(f"{name} {demand}, but {entry} is {value.detach()[tuple(index)].item():g}{others}")


def check_positive(name: str, value: float) -> None:
    """Refuse a setting that is not a positive finite number."""
    if not (math.isfinite(value) and value > 0):
        raise ConfigError(f"{name} must be a positive finite number, got {value}")
