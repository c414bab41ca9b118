"""The multilayer perceptron: one network, or S of them stacked and trained at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ikgrad.errors import ShapeError, UnknownNameError


class Activation(NamedTuple):
    """A unit's function and its derivative.

    Attributes:
        function: z -> y, elementwise.
        backward: (dL/dy, y) -> dL/dz in one kernel; None where only autograd knows the derivative.
    """

    function: Callable[[Tensor], Tensor]
    backward: Callable[[Tensor, Tensor], Tensor] | None = None


ACTIVATIONS = {
    "logistic": Activation(torch.sigmoid, torch.ops.aten.sigmoid_backward),
    "tanh": Activation(torch.tanh, torch.ops.aten.tanh_backward),
    "linear": Activation(lambda z: z, lambda grad, y: grad),
    "relu": Activation(torch.relu, lambda grad, y: grad * (y > 0.0)),
    "silu": Activation(nn.functional.silu),
    "gelu": Activation(nn.functional.gelu),
}


class MLP(nn.Module):
    r"""Layers of units in a row, each seeing all units of the layer before.

    ``y_0 = x,  y_l = g(y_{l-1} W_l + b_l)``, with one g for the hidden layers and one for the last.

    With ``members=S`` every parameter has S in front, ``W_l`` is (S, in, out) and the S networks answer and learn side
    by side: one batched matrix product instead of S small ones. Members never mix, and an optimizer that treats each
    weight by itself trains them as S independent networks, if their losses are summed.

    Args:
        sizes: units of each layer, inputs first, such as ``(3, 10, 6)``.
        hidden: activation of the hidden layers: logistic, tanh, linear, relu, silu or gelu.
        output: activation of the last layer.
        members: number of stacked networks; None: one network without a leading dimension.
        seeds: of the first weights, one for each member (one int for a single network). A member's first weights depend
            on its own seed alone.
        bound: first weights and biases are uniform in +-bound; default: 1 / sqrt(units of the layer before).
        dtype: of the parameters.

    Raises:
        ShapeError: fewer than two sizes, a size below one, or other than one seed a member.
        UnknownNameError: no such activation.

    Example:
        >>> net = MLP((3, 10, 6), hidden="logistic", output="logistic", members=4, seeds=range(4))
        >>> x = torch.zeros(9, 3, dtype=torch.float64)
        >>> net(x).shape
        torch.Size([4, 9, 6])
        >>> net.member(2)(x).shape
        torch.Size([9, 6])
    """

    def __init__(
        self,
        sizes: Sequence[int],
        *,
        hidden: str = "tanh",
        output: str = "linear",
        members: int | None = None,
        seeds: int | Sequence[int] = 0,
        bound: float | None = None,
        dtype: torch.dtype = torch.float64,
    ):
        super().__init__()
        _check(sizes, hidden, output, members)
        self.sizes, self.hidden, self.output, self.members = tuple(sizes), hidden, output, members
        lead = () if members is None else (members,)
        shapes = list(pairwise(self.sizes))
        self.weights = nn.ParameterList(torch.empty(*lead, a, b, dtype=dtype) for a, b in shapes)
        self.biases = nn.ParameterList(torch.empty(*lead, 1, b, dtype=dtype) for _, b in shapes)
        self.reset(seeds, bound=bound)

    @torch.no_grad()
    def reset(self, seeds: int | Sequence[int], *, bound: float | None = None) -> None:
        """Draw all parameters anew, each member from its own seed.

        Raises:
            ShapeError: other than one seed a member.
        """
        wanted = [seeds] if isinstance(seeds, int) else list(seeds)
        if len(wanted) != (self.members or 1):
            raise ShapeError(f"seeds must hold {self.members or 1} numbers, one for each member, got {len(wanted)}")
        for k, seed in enumerate(wanted):
            generator = torch.Generator().manual_seed(seed)
            for weight, bias in zip(self.weights, self.biases, strict=True):
                limit = weight.shape[-2] ** -0.5 if bound is None else bound
                for parameter in (weight, bias):
                    target = parameter if self.members is None else parameter[k]
                    draw = torch.rand(target.shape, dtype=torch.float64, generator=generator)
                    target.copy_(limit * (2.0 * draw - 1.0))

    def forward(self, x: Tensor) -> Tensor:
        """Answers of the network.

        Args:
            x: (..., B, inputs), or for stacked members (B, inputs) shared by all or (S, B, inputs). A single network
                also takes (inputs,).

        Returns:
            (..., B, outputs); for members (S, B, outputs).
        """
        return self.layers(x)[-1]

    def layers(self, x: Tensor) -> list[Tensor]:
        """The input and every layer's answer, ``[y_0, ..., y_L]``."""
        if x.shape[-1:] != (self.sizes[0],):
            raise ShapeError(f"x must have shape (..., {self.sizes[0]}), got {tuple(x.shape)}")
        if self.members is not None:
            if x.ndim < 2 or (x.ndim > 2 and x.shape[0] not in (1, self.members)):
                raise ShapeError(f"x must have shape (B, n) or ({self.members}, B, n), got {tuple(x.shape)}")
            x = x.expand(self.members, *x.shape[-2:])
        answers = [x]
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            z = torch.baddbmm(bias, answers[-1], weight) if self.members else answers[-1] @ weight + bias.squeeze(0)
            answers.append(ACTIVATIONS[self.output if k == last else self.hidden].function(z))
        return answers

    @property
    def knows_its_gradient(self) -> bool:
        """Whether `backpropagate` exists for these activations."""
        return all(ACTIVATIONS[name].backward is not None for name in (self.hidden, self.output))

    @torch.no_grad()
    def backpropagate(self, x: Tensor, target: Tensor) -> Tensor:
        r"""Gradients of half the squared error sum into every parameter's ``.grad``, without autograd.

        ``E = 1/2 sum (y - d)^2``; from the last layer down, delta_L = g'(z) (y - d), delta_l = g'(z) (delta_{l+1} W^T),
        and ``dE/dW_l = y_{l-1}^T delta_l``, ``dE/db_l`` the sum of delta_l over the patterns. The same numbers as
        autograd's, in half the time for small networks.

        Args:
            x: (B, inputs), or (S, B, inputs) for members.
            target: (B, outputs) or (S, B, outputs), the d of the equation.

        Returns:
            y - d, (B, outputs) or (S, B, outputs).

        Source:
            Yildirim and Eski (2006), eqs. (34)-(50).

        Differences:
            Eqs. (38) and (49) are for linear outputs; here g' of the last layer is in, as its logistic units demand.
        """
        answers = self.layers(x)
        error = answers[-1] - target
        grad, name = error, self.output
        for k in reversed(range(len(self.weights))):
            backward = ACTIVATIONS[name].backward
            assert backward is not None
            delta = backward(grad, answers[k + 1])
            self.weights[k].grad = answers[k].mT @ delta
            self.biases[k].grad = delta.sum(-2, keepdim=True)
            if k > 0:
                grad, name = delta @ self.weights[k].mT, self.hidden
        return error

    def member(self, index: int) -> MLP:
        """One of the stacked networks as a network of its own, parameters copied."""
        if self.members is None:
            raise ShapeError("this is a single network, it has no members")
        single = MLP(self.sizes, hidden=self.hidden, output=self.output, dtype=self.weights[0].dtype)
        single = single.to(self.weights[0].device)
        with torch.no_grad():
            for ours, theirs in zip(single.parameters(), self.parameters(), strict=True):
                ours.copy_(theirs[index])
        return single

    def extra_repr(self) -> str:
        """Sizes and activations, for ``print(network)``."""
        sizes = "-".join(map(str, self.sizes))
        return f"{sizes}, hidden={self.hidden}, output={self.output}, members={self.members}"


def _check(sizes: Sequence[int], hidden: str, output: str, members: int | None) -> None:
    if len(sizes) < 2 or min(sizes) < 1:
        raise ShapeError(f"sizes must be two or more positive numbers, got {tuple(sizes)}")
    if members is not None and members < 1:
        raise ShapeError(f"members must be at least 1, got {members}")
    for name in (hidden, output):
        if name not in ACTIVATIONS:
            raise UnknownNameError("activation", name, ACTIVATIONS)


__all__ = ["ACTIVATIONS", "Activation", "MLP"]
