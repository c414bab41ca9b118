"""Delta-bar-delta: a learning rate for every weight."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.optim.optimizer import ParamsT

from ikgrad.optim.rule import Rule, require, require_fraction, require_lr


class DeltaBarDelta(Rule):
    r"""Every weight has its own rate: it grows while the gradient keeps its sign and shrinks when the sign turns.

    With ``g = dE/dw``, the trace ``dbar`` and the rate ``eps`` of one weight, in this order::

        eps(t)  = eps(t-1) + kappa      if dbar(t-1) g(t) > 0
                = eps(t-1) (1 - phi)    if dbar(t-1) g(t) < 0
                = eps(t-1)              else;   eps(0) = lr, dbar(0) = 0
        dbar(t) = (1 - theta) g(t) + theta dbar(t-1)
        dw(t)   = -eps(t) g(t) + momentum dw(t-1)

    Made for full batches: noise turns signs, and every turn shrinks a rate.

    Args:
        params: parameters, or groups of them.
        lr: rate that every weight starts with, at least 0; the paper has 0.05.
        kappa: what a rate gains in a step, at least 0. The rates have no upper limit; too large a value shows as a loss
            that jumps.
        phi: part of a rate that is lost when the sign turns, in [0, 1).
        theta: memory of the trace, in [0, 1); 0 compares with the last gradient alone.
        momentum: in [0, 1); the paper has 0.5.

    Source:
        eqs. (56), (57). Original: Jacobs, Increased rates of convergence through learning rate adaptation, Neural
        Networks 1 (1988). The paper prints no kappa, phi, theta; the defaults are those of our reproduction of it.

    Differences:
        The new rate is used in the same step, as Jacobs has it; eq. (56) leaves that open. Momentum is not in the
        original rule; Table 7 lists it, and it is the term of eq. (55). Signs are compared instead of multiplying,
        so that gradients of 1e-30 do not vanish in a product of float32. A scheduler scales all steps by
        lr / (lr at the start), since the rates themselves belong to the rule; from a start of 0 there is nothing to
        scale by, and the rates grow by kappa alone.

    Example:
        >>> w = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
        >>> optimizer = DeltaBarDelta([w], lr=0.125, kappa=0.125)
        >>> for _ in range(2):
        ...     optimizer.zero_grad()
        ...     w.square().sum().backward()
        ...     optimizer.step()
        >>> w.tolist()
        [0.375, -0.75]
    """

    def __init__(
        self,
        params: ParamsT,
        lr: float,
        *,
        kappa: float = 0.01,
        phi: float = 0.1,
        theta: float = 0.7,
        momentum: float = 0.0,
    ):
        super().__init__(params, dict(lr=lr, kappa=kappa, phi=phi, theta=theta, momentum=momentum))

    def _check(self, group: dict[str, Any]) -> None:
        require_lr(group["lr"])
        require(0.0 <= group["kappa"] < math.inf, "kappa", group["kappa"])
        for name in ("phi", "theta", "momentum"):
            require_fraction(name, group[name])

    def _update(self, param: Tensor, grad: Tensor, state: dict[str, Any], group: dict[str, Any]) -> None:
        if not state:
            # A warm-up has lowered lr before the first step; the scheduler notes the full value as initial_lr.
            state["lr_start"] = float(group.get("initial_lr", group["lr"]))
            state["rate"] = torch.full_like(param, state["lr_start"])
            state["trace"] = torch.zeros_like(param)
        _adapt(state["rate"], state["trace"].sign() * grad.sign(), group["kappa"], group["phi"])
        state["trace"].mul_(group["theta"]).add_(grad, alpha=1.0 - group["theta"])
        schedule = group["lr"] / state["lr_start"] if state["lr_start"] > 0.0 else 1.0
        step = (state["rate"] * grad).mul_(-schedule)
        if group["momentum"] > 0.0:
            if "last_step" not in state:
                state["last_step"] = torch.zeros_like(param)
            step = state["last_step"].mul_(group["momentum"]).add_(step)
        param.add_(step)


def _adapt(rate: Tensor, agreement: Tensor, kappa: float, phi: float) -> None:
    """Eq. (56) in place; ``agreement`` is +1 where the gradient has the sign of its trace, -1 where not, or 0."""
    rate.copy_(torch.where(agreement < 0.0, rate * (1.0 - phi), rate)).add_(agreement.clamp(min=0.0), alpha=kappa)
