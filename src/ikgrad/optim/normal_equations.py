"""J^T J and J^T r of a residual tensor, by the cheapest way that its graph allows, in pieces of limited size.

    layers    all weights belong to linear layers and rows do not mix: one backward pass for each residual of a row
    columns   fewer weights than residuals: one pass for each weight
    rows      one pass for each residual

J^T r comes from autograd, so it is exact whatever happens. A way whose own J^T r differs from it has misread the graph
and the next one is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.optim.layers import Layer, Weights, find_layers

PIECE = 4_000_000  # numbers in a temporary: 32 MB of float64, which measured best and is small beside J^T J


@dataclass(frozen=True)
class NormalEquations:
    """J^T J and J^T r of S independent problems, and the order of the P weights in them.

    Attributes:
        matrix: (S, P, P) lower triangle of J^T J.
        gradient: (S, P) J^T r, half the gradient of r^T r.
        split: takes a vector (S, P) apart into one tensor for each parameter.
    """

    matrix: Tensor
    gradient: Tensor
    split: Callable[[Tensor], list[Tensor]]


def normal_equations(residuals: Tensor, params: Sequence[Tensor], members: int | None) -> NormalEquations:
    """J^T J and J^T r where J = d residuals / d params.

    Args:
        residuals: (...) with a graph; (S, ...) for members, each depending on its own parameters alone.
        params: each with S in front for members.
        members: S, or None for one problem.
    """
    with torch.enable_grad():
        r = residuals.reshape(members or 1, -1)
    gradients = _vjp(r, params, r.detach())
    layers = find_layers(residuals, params, members)
    if layers is not None and r.shape[1] % layers[0].x.shape[1] == 0:
        found = _by_layers(r, params, gradients, layers)
        if found is not None:
            return found
    flat = _Flat(params, members or 1)
    gradient = flat.join(gradients)
    if 2 * gradient.shape[1] < r.shape[1]:
        found = _by_columns(r, params, gradient, flat)
        if found is not None:
            return found
    return NormalEquations(_by_rows(r, params, flat), gradient, flat.split)


def _vjp(r: Tensor, params: Sequence[Tensor], v: Tensor, *, again: bool = False) -> list[Tensor]:
    grads = torch.autograd.grad(
        r, params, v, retain_graph=True, create_graph=again, allow_unused=True, materialize_grads=True
    )
    if any(g.layout is not torch.strided for g in grads):
        raise RuntimeError(
            "LevenbergMarquardt does not support sparse gradients; build the embedding with sparse=False"
        )
    return list(grads)


def _ones_at(like: Tensor, columns: int | slice) -> Tensor:
    e = torch.zeros_like(like)
    e[:, columns] = 1.0
    return e


def _agrees(ours: Tensor, exact: Tensor, matrix: Tensor, r: Tensor) -> bool:
    """Whether J^T r is the exact one, up to rounding in a sum whose terms |J_j| |r| bounds."""
    scale = matrix.diagonal(dim1=-2, dim2=-1).sqrt() * r.norm(dim=-1, keepdim=True)
    tolerance = torch.finfo(ours.dtype).eps ** 0.6
    return bool(((ours - exact).abs() <= tolerance * scale).logical_or(~scale.isfinite()).all())


class _Flat:
    """Parameters one after the other, in the order given."""

    def __init__(self, params: Sequence[Tensor], members: int):
        self.shapes, self.members = [p.shape for p in params], members
        self.sizes = [p.numel() // members for p in params]

    def join(self, tensors: Sequence[Tensor]) -> Tensor:
        return torch.cat([t.reshape(self.members, -1) for t in tensors], 1)

    def split(self, vector: Tensor) -> list[Tensor]:
        return [part.reshape(s) for part, s in zip(vector.split(self.sizes, 1), self.shapes, strict=True)]


def _by_rows(r: Tensor, params: Sequence[Tensor], flat: _Flat) -> Tensor:
    S, N = r.shape
    P = sum(flat.sizes)
    H = r.new_zeros(S, P, P)
    for piece in _pieces(N, S * P):
        J = torch.stack([flat.join(_vjp(r, params, _ones_at(r, n))) for n in range(N)[piece]], 1)
        H.baddbmm_(J.mT, J)
    return H


def _by_columns(r: Tensor, params: Sequence[Tensor], gradient: Tensor, flat: _Flat) -> NormalEquations | None:
    """J column by column: J^T v is linear in v, and its derivative by v is a column.

    Pieces of columns are made again for every other piece, so that J is never held whole.
    """
    (S, N), P = r.shape, gradient.shape[1]
    v = torch.ones_like(r, requires_grad=True)
    with torch.enable_grad():
        g = flat.join(_vjp(r, params, v, again=True))
    if not g.requires_grad:
        return None

    def columns(piece: slice) -> Tensor:
        return torch.stack([_vjp(g, [v], _ones_at(g, j))[0] for j in range(P)[piece]], 1)

    H, ours = r.new_zeros(S, P, P), torch.empty_like(gradient)
    pieces = list(_pieces(P, S * N))
    for k, left in enumerate(pieces):
        Jl = columns(left)
        ours[:, left] = (Jl @ r.detach().unsqueeze(2)).squeeze(2)
        H[:, left, left] = Jl @ Jl.mT
        for below in pieces[k + 1 :]:
            H[:, below, left] = columns(below) @ Jl.mT
    return NormalEquations(H, gradient, flat.split) if _agrees(ours, gradient, H, r) else None


def _pieces(count: int, numbers_each: int) -> Iterator[slice]:
    size = max(1, PIECE // max(1, numbers_each))
    return (slice(k, min(k + size, count)) for k in range(0, count, size))


class _Layered:
    """Weights of layers one after the other, each W with b as its last row, (in + 1, out) or (in, out)."""

    def __init__(self, layers: Sequence[Layer], params: Sequence[Tensor], members: int):
        self.params, self.members = params, members
        self.weights = list(dict.fromkeys(layer.weights for layer in layers))
        self.widths: dict[Weights, tuple[int, int]] = {}
        self.places: dict[Weights, slice] = {}
        end = 0
        for w in self.weights:
            a, c = params[w.weight].shape[-2:][:: -1 if w.transposed else 1]
            self.widths[w] = (a + (w.bias is not None), c)
            start, end = end, end + math.prod(self.widths[w])
            self.places[w] = slice(start, end)
        self.size = end

    def join(self, tensors: Sequence[Tensor]) -> Tensor:
        parts = []
        for w in self.weights:
            W = tensors[w.weight].mT if w.transposed else tensors[w.weight]
            parts.append(W.reshape(self.members, -1))
            if w.bias is not None:
                parts.append(tensors[w.bias].reshape(self.members, -1))
        return torch.cat(parts, 1)

    def split(self, vector: Tensor) -> list[Tensor]:
        """One tensor for each parameter; zeros for those that no layer uses."""
        tensors = [torch.zeros_like(p) for p in self.params]
        for w in self.weights:
            matrix = vector[:, self.places[w]].unflatten(1, self.widths[w])
            if w.bias is not None:
                tensors[w.bias] = matrix[:, -1].reshape(self.params[w.bias].shape)
                matrix = matrix[:, :-1]
            tensors[w.weight] = (matrix.mT if w.transposed else matrix).reshape(self.params[w.weight].shape)
        return tensors


def _by_layers(
    r: Tensor, params: Sequence[Tensor], gradients: Sequence[Tensor], layers: Sequence[Layer]
) -> NormalEquations | None:
    r"""J^T J from what goes into each layer and what comes back to it.

    Row i, residual k, layer l: dr_ik / dW_l = x_li (x) delta_lik, the gradient of z. The block of layers l and l' is
    ``sum_i (x_li x_l'i^T) (x) (sum_k delta_lik delta_l'ik^T)``, one matrix product over i, with as many multiplications
    for all residuals of a row as J^T J takes for one.
    """
    order = _Layered(layers, params, r.shape[0])
    gradient = order.join(gradients)
    xs = [_with_bias(layer) for layer in layers]
    deltas = _deltas(r, layers)
    H, ours = r.new_zeros(r.shape[0], order.size, order.size), torch.zeros_like(gradient)
    for k, layer in enumerate(layers):
        place = order.places[layer.weights]
        ours[:, place] += _half_gradient(xs[k], deltas[k], r)
        for j, other in enumerate(layers):
            if order.places[other.weights].start <= place.start:
                shape = (*order.widths[layer.weights], *order.widths[other.weights])
                block = H[:, place, order.places[other.weights]].unflatten(2, shape[2:]).unflatten(1, shape[:2])
                _add_block(block.transpose(2, 3), xs[k], xs[j], deltas[k], deltas[j])
    return NormalEquations(H, gradient, order.split) if _agrees(ours, gradient, H, r.detach()) else None


def _with_bias(layer: Layer) -> Tensor:
    x = layer.x
    return x if layer.weights.bias is None else torch.cat([x, x.new_ones(*x.shape[:-1], 1)], -1)


def _deltas(r: Tensor, layers: Sequence[Layer]) -> list[Tensor]:
    """(S, B, m, out) for each layer: derivative of the m residuals of a row by its z; one backward pass for each m."""
    S, B = layers[0].x.shape[:2]
    m = r.shape[1] // B
    edges = [layer.edge for layer in layers]
    found: list[Tensor] = []
    for k in range(m):
        e = _ones_at(r, slice(k, None, m))
        grads = [g.reshape(S, B, -1) for g in torch.autograd.grad(r, edges, e, retain_graph=True)]
        if not found:
            found = [g.new_empty(S, B, m, g.shape[-1]) for g in grads]
        for delta, g in zip(found, grads, strict=True):
            delta[:, :, k] = g
    return found


def _half_gradient(x: Tensor, delta: Tensor, r: Tensor) -> Tensor:
    dz = (r.detach().reshape(*delta.shape[:2], 1, -1) @ delta).squeeze(2)  # (S, B, out)
    return (x.mT @ dz).flatten(1)


def _add_block(block: Tensor, x: Tensor, x2: Tensor, delta: Tensor, delta2: Tensor) -> None:
    """Add to (S, in, in', out, out'); of a layer with itself only what is on or below the diagonal of (in, in')."""
    S, B, a = x.shape
    a2, c, c2 = x2.shape[-1], delta.shape[-1], delta2.shape[-1]
    if x is x2:
        down, across = torch.tril_indices(a, a, device=x.device)
    else:
        down, across = torch.cartesian_prod(torch.arange(a), torch.arange(a2)).to(x.device).unbind(1)
    xt, xt2 = x.mT.contiguous(), x2.mT.contiguous()
    total = x.new_zeros(S, len(down), c * c2)
    for piece in _pieces(B, S * (len(down) + c * c2)):
        dd = (delta[:, piece].mT @ delta2[:, piece]).flatten(2)  # (S, b, c c')
        total.baddbmm_(xt[:, down, piece] * xt2[:, across, piece], dd)
    block[:, down, across] += total.unflatten(2, (c, c2))
