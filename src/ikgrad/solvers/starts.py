"""Random starts that depend on the row alone: counter-based random numbers keyed by seed and content.

The same pose with the same seed starts at the same places wherever it stands in whatever batch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.robot import Robot

# Multipliers of the splitmix64 generator (Steele, Lea, Flood 2014), written as signed 64-bit numbers.
_GAMMA = 0x9E3779B97F4A7C15 - 2**64
_MIX_1 = 0xBF58476D1CE4E5B9 - 2**64
_MIX_2 = 0x94D049BB133111EB - 2**64


def _shift(x: Tensor, bits: int) -> Tensor:
    """Logical right shift of int64 (torch's own keeps the sign)."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)


def _mix(x: Tensor) -> Tensor:
    """The splitmix64 finaliser: every input bit reaches every output bit."""
    x = (x ^ _shift(x, 30)) * _MIX_1
    x = (x ^ _shift(x, 27)) * _MIX_2
    return x ^ _shift(x, 31)


def row_keys(T_target: Tensor, q0: Tensor | None, seed: int) -> Tensor:
    """One int64 per row from the bits of its pose (and ``q0``) and the seed.

    Args:
        T_target: (B, 4, 4) float64.
        q0: (B, n) float64 or None.
        seed: any int.

    Returns:
        (B,) int64
    """
    content = T_target.flatten(1) if q0 is None else torch.cat([T_target.flatten(1), q0], dim=1)
    words = (content + 0.0).contiguous().view(torch.int64)  # adding 0.0 makes -0.0 and 0.0 one content
    signed = (seed + 2**63) % 2**64 - 2**63
    key = torch.full_like(words[:, 0], signed)
    for word in words.unbind(1):
        key = _mix((key ^ word) + _GAMMA)
    return key


def random_configurations(robot: Robot, key: Tensor, draw: Tensor) -> Tensor:
    """Configurations uniform over the sampling range, a function of (key, draw) alone.

    Args:
        robot: the robot, n joint variables.
        key: (B,) int64
        draw: (B,) or (B, c) int64, the number of the draw.

    Returns:
        (*draw.shape, n) float64
    """
    low, high = (limit.to(key.device, torch.float64) for limit in robot.sampling_range)
    joints = torch.arange(robot.dof, device=key.device)
    counter = draw[..., None] * robot.dof + joints + 1
    bits = _mix(key.reshape(-1, *[1] * draw.ndim) + counter * _GAMMA)
    unit = _shift(bits, 11).double() * 2.0**-53  # [0, 1)
    return low + unit * (high - low)
