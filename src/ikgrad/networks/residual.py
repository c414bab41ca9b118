"""A multilayer perceptron with short cuts, for inverters that learn for minutes rather than epochs."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from ikgrad.errors import ShapeError, UnknownNameError
from ikgrad.networks.mlp import ACTIVATIONS

_FIRST_OUTPUT = 0.1  # the last layer begins small: an untrained network leaves the joints nearly where they are


class ResidualMLP(nn.Module):
    r"""Layers of equal width, each adding to what the layer before said: ``h_{l+1} = h_l + g(W_l h_l + b_l)``.

    The short cuts keep the gradient alive, and all inner matrices are square, which is what optimizers of matrices
    (Muon) are good at; see `inner`.

    Args:
        inputs: numbers that come in.
        outputs: numbers that go out.
        width: units of each hidden layer.
        depth: hidden layers, the first one included.
        activation: g, of `ikgrad.networks.ACTIVATIONS`.
        seed: of the first weights.
        dtype: of the parameters.

    Raises:
        ShapeError: a size below one.
        UnknownNameError: no such activation.

    Example:
        >>> net = ResidualMLP(5, 2, width=16, depth=3)
        >>> net(torch.zeros(4, 5)).shape, len(net.inner)
        (torch.Size([4, 2]), 2)
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        width: int = 160,
        depth: int = 4,
        activation: str = "gelu",
        seed: int = 0,
        dtype: torch.dtype = torch.float32,
    ):
        super().__init__()
        if min(inputs, outputs, width, depth) < 1:
            raise ShapeError(f"sizes must be at least 1, got {inputs} inputs, {outputs} outputs, {width} x {depth}")
        if activation not in ACTIVATIONS:
            raise UnknownNameError("activation", activation, ACTIVATIONS)
        self.width, self.depth, self.activation = width, depth, activation
        sizes = [inputs, *[width] * depth, outputs]
        self.layers = nn.ModuleList(nn.utils.skip_init(nn.Linear, a, b, dtype=dtype) for a, b in pairwise(sizes))
        self._draw(seed)

    @property
    def inner(self) -> list[nn.Parameter]:
        """The square matrices between hidden layers."""
        return [layer.weight for layer in self.layers[1:-1]]  # type: ignore[misc]

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) -> (..., outputs)."""
        g = ACTIVATIONS[self.activation].function
        first, *inner, last = self.layers
        h = g(first(x))
        for layer in inner:
            more = g(layer(h))
            h = h + more if torch.is_grad_enabled() else h.add_(more)  # in place: no new pages, a quarter of the time
        return last(h)

    @torch.no_grad()
    def _draw(self, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        for layer in self.layers:
            for parameter in layer.parameters():
                limit = layer.in_features**-0.5  # type: ignore[operator]
                draw = torch.rand(parameter.shape, dtype=torch.float64, generator=generator)
                parameter.copy_(limit * (2.0 * draw - 1.0))
        self.layers[-1].weight.mul_(_FIRST_OUTPUT)  # type: ignore[operator]
        self.layers[-1].bias.zero_()  # type: ignore[operator]

    def extra_repr(self) -> str:
        """Sizes, for ``print(network)``."""
        return f"width={self.width}, depth={self.depth}, activation={self.activation}"


__all__ = ["ResidualMLP"]
