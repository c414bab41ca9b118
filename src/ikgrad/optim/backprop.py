"""Steepest descent with momentum, the rule behind the paper's cases 1 to 3."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.optim.optimizer import ParamsT

from ikgrad.optim.rule import Rule, require_fraction, require_lr


class Backprop(Rule):
    r"""Steepest descent with momentum: each step follows the gradient and keeps a part of the step before.

    ``dw(t) = -lr g(t) + momentum dw(t-1)``, computed as ``v <- momentum v + g``, ``w <- w - lr v``.

    The data decide what it is: one pattern a step in fixed order (OBP, case 1), in a new random order every epoch
    (OBPR, case 2: ``DataLoader(..., batch_size=1, shuffle=True)``), or all patterns a step (BBP, case 3).

    Args:
        params: parameters, or groups of them.
        lr: learning rate eta, at least 0; the paper has 0.05.
        momentum: alpha, in [0, 1); the paper has 0.5.

    Source:
        eqs. (51)-(55). Original: Rumelhart, Hinton, Williams, Learning representations by back-propagating errors,
        Nature 323 (1986).

    Differences:
        Eq. (55) adds up steps, this rule adds up gradients, as `torch.optim.SGD` does, with which it agrees always.
        With a constant ``lr`` the two are the same, dw = -lr v. When a scheduler lowers ``lr``, steps taken
        earlier shrink with it here, and would not in eq. (55). Weights and biases share one rate unless they are put
        in two groups (the paper writes eta_w and eta_b, and gives one number).

    Example:
        >>> w = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
        >>> optimizer = Backprop([w], lr=0.25)
        >>> w.square().sum().backward()
        >>> optimizer.step()
        >>> w.tolist()
        [0.5, -1.0]
    """

    def __init__(self, params: ParamsT, lr: float, *, momentum: float = 0.0):
        super().__init__(params, dict(lr=lr, momentum=momentum))

    def _check(self, group: dict[str, Any]) -> None:
        require_lr(group["lr"])
        require_fraction("momentum", group["momentum"])

    def _update(self, param: Tensor, grad: Tensor, state: dict[str, Any], group: dict[str, Any]) -> None:
        if group["momentum"] > 0.0:
            if "momentum_buffer" not in state:
                state["momentum_buffer"] = torch.zeros_like(param)
            grad = state["momentum_buffer"].mul_(group["momentum"]).add_(grad)
        param.add_(grad, alpha=-group["lr"])
