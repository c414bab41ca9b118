"""J^T J and J^T r of a residual tensor, by the cheapest way that its graph allows, in pieces of limited size.

    layers    all weights belong to linear layers and rows do not mix: one backward pass for each residual of a row
    columns   fewer weights than residuals: one pass for each weight
    rows      one pass for each residual

J^T r comes from autograd, so it is exact in any case. A way whose own J^T r differs from it has misread the graph, and
the next one is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.optim.layer_blocks import LayerOrder, layer_blocks, ones_at, pieces
from ikgrad.optim.layers import find_layers


@dataclass(frozen=True)
class NormalEquations:
    """J^T J and J^T r of S independent problems, and the order of the P weights in them.

    Attributes:
        matrix: (S, P, P), of which the lower triangle is J^T J.
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

    Raises:
        RuntimeError: a gradient is sparse.
    """
    with torch.enable_grad():
        r = residuals.reshape(members or 1, -1)
    gradients = _vjp(r, params, r.detach())
    layers = find_layers(residuals, params, members)
    if layers is not None and r.shape[1] % layers[0].x.shape[1] == 0:
        order = LayerOrder(layers, params, r.shape[0])
        gradient = order.join(gradients)
        matrix, ours = layer_blocks(r, layers, order)
        if _agree(ours, gradient, matrix, r):
            return NormalEquations(matrix, gradient, order.split)
        del matrix
    flat = _FlatOrder(params, r.shape[0])
    gradient = flat.join(gradients)
    if 2 * gradient.shape[1] < r.shape[1]:
        by_columns = _by_columns(r, params, flat)
        if by_columns is not None and _agree(by_columns[1], gradient, by_columns[0], r):
            return NormalEquations(by_columns[0], gradient, flat.split)
    return NormalEquations(_by_rows(r, params, flat), gradient, flat.split)


def _agree(ours: Tensor, exact: Tensor, matrix: Tensor, r: Tensor) -> bool:
    """Whether J^T r is exact up to rounding, which |J_j| |r| bounds; numbers that are not finite say nothing."""
    scale = matrix.diagonal(dim1=-2, dim2=-1).sqrt() * r.detach().norm(dim=-1, keepdim=True)
    close = (ours - exact).abs() <= torch.finfo(ours.dtype).eps ** 0.6 * scale
    return bool((close | ~scale.isfinite() | ~exact.isfinite()).all())


class _FlatOrder:
    """Parameters one after the other, as given."""

    def __init__(self, params: Sequence[Tensor], members: int):
        self.shapes, self.members = [p.shape for p in params], members
        self.sizes = [p.numel() // members for p in params]

    def join(self, tensors: Sequence[Tensor]) -> Tensor:
        return torch.cat([t.reshape(self.members, -1) for t in tensors], 1)

    def split(self, vector: Tensor) -> list[Tensor]:
        return [part.reshape(s) for part, s in zip(vector.split(self.sizes, 1), self.shapes, strict=True)]


def _vjp(r: Tensor, params: Sequence[Tensor], v: Tensor, *, again: bool = False) -> list[Tensor]:
    grads = torch.autograd.grad(
        r, params, v, retain_graph=True, create_graph=again, allow_unused=True, materialize_grads=True
    )
    if any(grad.layout is not torch.strided for grad in grads):
        raise RuntimeError(
            "LevenbergMarquardt does not support sparse gradients; build the embedding with sparse=False"
        )
    return list(grads)


def _by_rows(r: Tensor, params: Sequence[Tensor], flat: _FlatOrder) -> Tensor:
    (S, N), P = r.shape, sum(flat.sizes)
    H = r.new_zeros(S, P, P)
    for piece in pieces(N, S * P):
        J = torch.stack([flat.join(_vjp(r, params, ones_at(r, n))) for n in range(N)[piece]], 1)
        H.baddbmm_(J.mT, J)
    return H


def _by_columns(r: Tensor, params: Sequence[Tensor], flat: _FlatOrder) -> tuple[Tensor, Tensor] | None:
    """J^T J and J^T r from columns: J^T v is linear in v, and the derivative of its entry j by v is column j of J.

    Columns are made again for every piece to their left, so that J is never held whole. None if the graph cannot be
    differentiated twice.
    """
    (S, N), P = r.shape, sum(flat.sizes)
    v = torch.ones_like(r, requires_grad=True)
    with torch.enable_grad():
        g = flat.join(_vjp(r, params, v, again=True))
    try:
        _vjp(g, [v], ones_at(g, 0))
    except RuntimeError:  # some backward pass has no derivative of its own; want of memory shows again in the rows
        return None

    def columns(piece: slice) -> Tensor:
        return torch.stack([_vjp(g, [v], ones_at(g, j))[0] for j in range(P)[piece]], 1)  # (S, p, N)

    H, ours = r.new_zeros(S, P, P), g.new_zeros(S, P)
    parts = list(pieces(P, S * N, largest=True))
    for k, part in enumerate(parts):
        J = columns(part)
        ours[:, part] = (J @ r.detach().unsqueeze(2)).squeeze(2)
        H[:, part, part] = J @ J.mT
        for below in parts[k + 1 :]:
            H[:, below, part] = columns(below) @ J.mT
    return H, ours
