"""What a network is trained to make small: residuals of its scaled answers, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from ikgrad.networks import Inverter
from ikgrad.training.loop import Objective

Loss = Callable[[Sequence[Inverter]], Objective]


def joint(inverters: Sequence[Inverter]) -> Objective:
    """``r = q - d`` in joint units: the mean square is in rad^2 for an arm with turning joints.

    Args:
        inverters: S of them, whose scaling is known.

    Returns:
        (stack, x, y) -> (S, B, n) residuals, x and y scaled as the inverters do it.
    """
    half = torch.stack([inverter.output_scale.span for inverter in inverters])[:, None] / 2.0  # (S, 1, n)

    def residuals(stack: nn.Module, x: Tensor, y: Tensor) -> Tensor:
        return half * (stack(x) - y)

    return residuals


LOSSES: dict[str, Loss] = {"joint": joint}

__all__ = ["LOSSES", "Loss", "joint"]
