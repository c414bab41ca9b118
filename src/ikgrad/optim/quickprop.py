"""Quickprop: for every weight, jump to the bottom of a parabola through the last two slopes."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.optim.optimizer import ParamsT

from ikgrad.optim.rule import Rule, require, require_lr


class Quickprop(Rule):
    r"""Each weight jumps to the bottom of the parabola through its last two slopes, at most mu times its last step.

    With the slope ``S = dE/dw + weight_decay w`` and the last step ``dw = dw(t-1)`` of one weight::

        still downhill along dw:  dw(t) = min(S(t) / (S(t-1) - S(t)), mu) dw - lr S(t)
        minimum passed:           dw(t) = S(t) / (S(t-1) - S(t)) dw
        dw = 0:                   dw(t) = -lr S(t)

    The ratio counts as larger than mu also where the slope did not fall, where the parabola opens downwards or has no
    bottom (S(t) = S(t-1)); so nothing is ever divided by zero. Made for full batches: noise between two steps ruins
    the parabola.

    Args:
        params: parameters, or groups of them.
        lr: rate of the gradient term, Fahlman's epsilon, at least 0; the paper has 0.05. With 0 nothing ever starts.
        mu: largest jump, in units of the last step, above 0; Fahlman recommends 1.75.
        weight_decay: Fahlman's remedy for slopes that go flat, at least 0. He used 1e-4, which is far too strong for
            a network that is to fit its data closely.
        max_step: our remedy, above 0: no weight changes by more in a step, so that none is thrown where its logistic
            unit is flat and all slopes vanish. It is in units of the weights; 0.1 suits logistic networks.
            ``math.inf`` leaves it out.
        literal: eq. (58) exactly as printed, for comparison; it diverges. Ignores ``mu``, ``weight_decay`` and
            ``max_step``.

    Source:
        eq. (58) and its text. Original: Fahlman, An empirical study of learning speed in back-propagation networks,
        CMU-CS-88-162 (1988).

    Differences:
        Eq. (58) always adds -lr S(t) and mentions mu in words only; here both are as Fahlman's program has them, and
        the text's second derivative has its sign put right: [S(t) - S(t-1)] / dw(t-1). Fahlman divides epsilon by
        the number of a unit's inputs and adds 0.1 to the derivative of the logistic function; an optimizer sees
        neither, so ``lr`` is used as given and ``max_step`` takes the place of the latter. ``literal`` takes the
        quotient as 0 where dw(t-1) = 0, or a weight without a slope would begin with 0/0.

    Example:
        >>> w = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
        >>> optimizer = Quickprop([w], lr=0.25, max_step=math.inf)
        >>> for _ in range(3):
        ...     optimizer.zero_grad()
        ...     w.square().sum().backward()
        ...     optimizer.step()
        >>> w.abs().max().item()
        0.0
    """

    def __init__(
        self,
        params: ParamsT,
        lr: float,
        *,
        mu: float = 1.75,
        weight_decay: float = 0.0,
        max_step: float = 0.1,
        literal: bool = False,
    ):
        super().__init__(params, dict(lr=lr, mu=mu, weight_decay=weight_decay, max_step=max_step, literal=literal))

    def _check(self, group: dict[str, Any]) -> None:
        require_lr(group["lr"])
        require(0.0 < group["mu"] < math.inf, "mu", group["mu"])
        require(0.0 <= group["weight_decay"] < math.inf, "weight_decay", group["weight_decay"])
        require(group["max_step"] > 0.0, "max_step", group["max_step"])

    def _update(self, param: Tensor, grad: Tensor, state: dict[str, Any], group: dict[str, Any]) -> None:
        if not state:
            state["last_step"] = torch.zeros_like(param)
            state["last_slope"] = torch.zeros_like(param)
        if group["literal"]:
            slope = grad
            step = _printed_step(slope, state["last_slope"], state["last_step"], group["lr"])
        else:
            slope = grad + group["weight_decay"] * param
            step = _fahlman_step(slope, state["last_slope"], state["last_step"], group["lr"], group["mu"])
            step.clamp_(-group["max_step"], group["max_step"])
        state["last_step"].copy_(step)
        state["last_slope"].copy_(slope)
        param.add_(step)


def _fahlman_step(slope: Tensor, last_slope: Tensor, last_step: Tensor, lr: float, mu: float) -> Tensor:
    """Next change of every weight.

    A last step always led downhill, so ``before`` is positive wherever there was one.
    """
    uphill = -last_step.sign()
    now, before = slope * uphill, last_slope * uphill  # steepness along the last step; now < 0: minimum passed
    limited = now >= mu / (1.0 + mu) * before  # ratio >= mu without dividing; also every case with no bottom ahead
    ratio = slope / torch.where(limited, 1.0, last_slope - slope)
    jump = torch.where(limited, mu, ratio) * last_step
    gradient_counts = (now > 0.0) | (last_step == 0.0)
    return jump - torch.where(gradient_counts, lr * slope, 0.0)


def _printed_step(slope: Tensor, last_slope: Tensor, last_step: Tensor, lr: float) -> Tensor:
    """Eq. (58) as printed: no growth limit, and the gradient term always."""
    jump = slope / (last_slope - slope) * last_step
    return torch.where(last_step == 0.0, 0.0, jump) - lr * slope
