"""J^T J of weights that enter through linear layers, block by block, without J."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.optim.layers import Layer, Weights

LARGEST = 16_000_000  # numbers in a temporary: 128 MB of float64
_CACHED = 500_000  # numbers that stay in the cache of a core between being made and being used


def pieces(count: int, numbers_each: int, *, largest: bool = False) -> Iterator[slice]:
    """Slices of ``range(count)``: as long as fits the cache, but long enough for matrix products to be efficient."""
    limit = max(1, LARGEST // max(1, numbers_each))
    size = limit if largest else min(limit, max(128, _CACHED // max(1, numbers_each)))
    return (slice(k, min(k + size, count)) for k in range(0, count, size))


def ones_at(like: Tensor, columns: int | slice) -> Tensor:
    """Zeros of the shape (S, N) of ``like``, with ones in some columns."""
    e = torch.zeros_like(like)
    e[:, columns] = 1.0
    return e


class LayerOrder:
    """Weights of layers one after the other, each W with b as its last row: (in + 1, out), or (in, out) without b."""

    def __init__(self, layers: Sequence[Layer], params: Sequence[Tensor], members: int):
        self.params, self.members, self.size = params, members, 0
        self.widths: dict[Weights, tuple[int, int]] = {}
        self.places: dict[Weights, slice] = {}
        for w in dict.fromkeys(layer.weights for layer in layers):
            a, c = params[w.weight].shape[-2:][:: -1 if w.transposed else 1]
            self.widths[w] = (a + (w.bias is not None), c)
            start, self.size = self.size, self.size + math.prod(self.widths[w])
            self.places[w] = slice(start, self.size)

    def join(self, tensors: Sequence[Tensor]) -> Tensor:
        """(S, P) from one tensor for each parameter."""
        parts = []
        for w in self.places:
            parts.append(tensors[w.weight].mT if w.transposed else tensors[w.weight])
            if w.bias is not None:
                parts.append(tensors[w.bias])
        return torch.cat([part.reshape(self.members, -1) for part in parts], 1)

    def split(self, vector: Tensor) -> list[Tensor]:
        """One tensor for each parameter from (S, P); zeros for those that no layer uses."""
        tensors = [torch.zeros_like(p) for p in self.params]
        for w, place in self.places.items():
            matrix = vector[:, place].unflatten(1, self.widths[w])
            if w.bias is not None:
                tensors[w.bias] = matrix[:, -1].reshape(self.params[w.bias].shape)
                matrix = matrix[:, :-1]
            tensors[w.weight] = (matrix.mT if w.transposed else matrix).reshape(self.params[w.weight].shape)
        return tensors

    def block(self, matrix: Tensor, rows: Weights, columns: Weights) -> Tensor:
        """View (S, in, in', out, out') of (S, P, P)."""
        part = matrix[:, self.places[rows], self.places[columns]]
        return part.unflatten(2, self.widths[columns]).unflatten(1, self.widths[rows]).transpose(2, 3)


@dataclass(frozen=True)
class _Flow:
    """What passes a layer: x (S, B, in) with a 1 for the bias, delta (S, B, m, out), derivatives of r by z.

    Where residual k depends on unit k alone, as in the last layer of a network, ``own`` is the diagonal of delta.
    """

    x: Tensor
    delta: Tensor
    own: Tensor | None  # (S, B, m)


def layer_blocks(r: Tensor, layers: Sequence[Layer], order: LayerOrder) -> tuple[Tensor, Tensor]:
    r"""Lower triangle of J^T J, and J^T r, from what goes into each layer and what comes back to it.

    Row i, residual k, layer l: ``dr_ik/dW_l = x_li delta_lik^T``. If rows do not mix, the block of layers l and l' is
    ``sum_i (x_li x_l'i^T) (x) (sum_k delta_lik delta_l'ik^T)``, a matrix product over i which takes all residuals of a
    row at the price of one.

    Args:
        r: (S, B m), B as in the layers, with a graph.
        layers: as found.
        order: of their weights.

    Returns:
        (S, P, P) and (S, P).
    """
    flows = _flows(r, layers)
    S = r.shape[0]
    H, g = r.new_zeros(S, order.size, order.size), r.new_zeros(S, order.size)
    for left, flow in zip(layers, flows, strict=True):
        g[:, order.places[left.weights]] += _gradient(flow, r.detach())
        for right, other in zip(layers, flows, strict=True):
            if order.places[right.weights].start <= order.places[left.weights].start:
                _add_products(order.block(H, left.weights, right.weights), flow, other)
    return H, g


def _flows(r: Tensor, layers: Sequence[Layer]) -> list[_Flow]:
    """One backward pass for each of the m residuals of a row, over all rows at once."""
    S, B = layers[0].x.shape[:2]
    m = r.shape[1] // B
    edges, deltas = [layer.edge for layer in layers], list[Tensor]()
    for k in range(m):
        grads = torch.autograd.grad(r, edges, ones_at(r, slice(k, None, m)), retain_graph=True)
        grads = tuple(grad.reshape(S, B, -1) for grad in grads)
        deltas = deltas or [grad.new_empty(S, B, m, grad.shape[-1]) for grad in grads]
        for delta, grad in zip(deltas, grads, strict=True):
            delta[:, :, k] = grad
    return [_Flow(_with_bias(layer), delta, _own(delta)) for layer, delta in zip(layers, deltas, strict=True)]


def _with_bias(layer: Layer) -> Tensor:
    x = layer.x
    return x if layer.weights.bias is None else torch.cat([x, x.new_ones(*x.shape[:-1], 1)], -1)


def _own(delta: Tensor) -> Tensor | None:
    if delta.shape[-2] != delta.shape[-1]:
        return None
    own = delta.diagonal(dim1=-2, dim2=-1)
    return own.contiguous() if delta.count_nonzero() == own.count_nonzero() else None


def _gradient(flow: _Flow, r: Tensor) -> Tensor:
    r = r.reshape(flow.delta.shape[:3])
    dz = r * flow.own if flow.own is not None else (r.unsqueeze(2) @ flow.delta).squeeze(2)  # (S, B, out)
    return (flow.x.mT @ dz).flatten(1)


def _add_products(block: Tensor, left: _Flow, right: _Flow) -> None:
    """Add to (S, in, in', out, out'); of a flow with itself only where in' <= in, the rest is above the diagonal."""
    (S, B, a), a2 = left.x.shape, right.x.shape[-1]
    c, c2 = block.shape[-2:]
    itself, only_own = left is right, left is right and left.own is not None
    pairs = a * (a + 1) // 2 if itself else a * a2
    total = block.new_zeros(S, pairs, c if only_own else c * c2)
    for piece in pieces(B, S * (pairs + c * c2)):
        x = left.x[:, piece].mT.contiguous()
        total.baddbmm_(_lower_pairs(x) if itself else _pairs(x, right.x[:, piece].mT), _inner(left, right, piece))
    if not itself:
        block += total.unflatten(2, (c, c2)).unflatten(1, (a, a2))
        return
    down, across = torch.tril_indices(a, a, device=block.device)
    if only_own:
        block.diagonal(dim1=-2, dim2=-1)[:, down, across] += total
    else:
        block[:, down, across] += total.unflatten(2, (c, c2))


def _inner(left: _Flow, right: _Flow, piece: slice) -> Tensor:
    """(S, b, out out'): ``sum_k delta_k delta'_k^T`` of every row; (S, b, out) if only its diagonal is not zero."""
    if left.own is None:
        return (left.delta[:, piece].mT @ right.delta[:, piece]).flatten(2)
    own = left.own[:, piece]
    return own.square() if left is right else (own.unsqueeze(3) * right.delta[:, piece]).flatten(2)


def _pairs(x: Tensor, x2: Tensor) -> Tensor:
    """(S, in, b), (S, in', b) -> (S, in in', b)."""
    return (x.unsqueeze(2) * x2.contiguous().unsqueeze(1)).flatten(1, 2)


def _lower_pairs(x: Tensor) -> Tensor:
    """(S, in, b) -> (S, in (in + 1) / 2, b): products of every two inputs, row by row of the lower triangle."""
    S, a, b = x.shape
    xx = x.new_empty(S, a * (a + 1) // 2, b)
    for k in range(a):
        start = k * (k + 1) // 2
        torch.mul(x[:, : k + 1], x[:, k : k + 1], out=xx[:, start : start + k + 1])
    return xx
