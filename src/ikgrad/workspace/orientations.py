"""A few orientations, spread evenly over all."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.rotations import matrix_from_quat_wxyz

_SECOND_RATIO = 1.533751168755204288118041413  # the positive root of x^4 = x + 4


def even_rotations(count: int) -> Tensor:
    """Rotations along a super-Fibonacci spiral: the same ones every time, more even than random ones.

    With s = k + 1/2, r = sqrt(s / count) and R = sqrt(1 - s / count), rotation k is the unit quaternion

        (r sin a, r cos a, R sin b, R cos b),   a = 2 pi s / sqrt(2),   b = 2 pi s / x,   x^4 = x + 4

    Source: M. Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3)", CVPR 2022.

    Args:
        count: how many.

    Returns:
        (count, 3, 3) float64.

    Raises:
        ConfigError: ``count`` is not positive.

    Example:
        >>> R = even_rotations(50)
        >>> bool((R @ R.mT - torch.eye(3)).abs().max() < 1e-14)
        True
    """
    if count < 1:
        raise ConfigError(f"orientations must be at least 1, got {count}")
    s = torch.arange(count, dtype=torch.float64) + 0.5
    r, R = (s / count).sqrt(), (1 - s / count).sqrt()
    a, b = 2 * math.pi * s / math.sqrt(2), 2 * math.pi * s / _SECOND_RATIO
    return matrix_from_quat_wxyz(torch.stack([r * a.sin(), r * a.cos(), R * b.sin(), R * b.cos()], dim=1))
