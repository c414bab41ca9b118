"""What the three rules share: the loop over parameters, and where bad input is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, overload

import torch
from torch import Tensor


def require(condition: bool, name: str, value: object) -> None:
    """Refuse a hyper-parameter in the words of torch: ``Invalid kappa: -1``."""
    if not condition:
        raise ValueError(f"Invalid {name}: {value}")


def require_lr(lr: float) -> None:
    """Refuse a learning rate that is negative or not finite."""
    require(0.0 <= lr < math.inf, "learning rate", lr)


def require_fraction(name: str, value: float) -> None:
    """Refuse a factor outside [0, 1); at 1 an average never moves and a momentum never fades."""
    require(0.0 <= value < 1.0, name, value)


def as_real(tensor: Tensor) -> Tensor:
    """A complex tensor as pairs of real numbers, any other as it is; shares memory with a parameter."""
    return torch.view_as_real(tensor.resolve_conj()) if tensor.is_complex() else tensor


class Rule(torch.optim.Optimizer):
    """An optimizer that changes every weight by itself; a subclass says how, in `_update`."""

    def _check(self, group: dict[str, Any]) -> None:
        """Raise ValueError if a setting of this group makes no sense."""
        raise NotImplementedError

    def _update(self, param: Tensor, grad: Tensor, state: dict[str, Any], group: dict[str, Any]) -> None:
        """Change ``param`` in place; ``state`` is empty at the first call."""
        raise NotImplementedError

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add a group of parameters; its own settings are checked like the defaults."""
        self._check({**self.defaults, **param_group})
        super().add_param_group(param_group)

    @overload
    def step(self, closure: None = None) -> None: ...

    @overload
    def step(self, closure: Callable[[], float]) -> float: ...

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:
        """Change all parameters that have a gradient.

        Args:
            closure: clears the gradients, computes the loss anew, calls ``backward`` and returns the loss.

        Returns:
            what the closure returned, else None.

        Raises:
            RuntimeError: a gradient is sparse; no parameter has been changed then.
        """
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        self._refuse_sparse_gradients()
        for group in self.param_groups:
            for param in group["params"]:
                if param.grad is not None:
                    self._update(as_real(param), as_real(param.grad), self.state[param], group)
        return loss

    def _refuse_sparse_gradients(self) -> None:
        for group in self.param_groups:
            if any(p.grad is not None and p.grad.layout is not torch.strided for p in group["params"]):
                name = type(self).__name__
                raise RuntimeError(f"{name} does not support sparse gradients; build the embedding with sparse=False")
