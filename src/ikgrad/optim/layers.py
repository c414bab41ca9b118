"""Finds, in the graph behind a residual tensor, the linear layers through which weights enter it.

A linear layer is ``z = x W + b`` in any of the forms that autograd records for `torch.nn.Linear`, ``x @ W + b``,
`torch.addmm` and, for stacked networks, `torch.baddbmm`. The node of the product holds x, and the gradient that arrives
there is that of z; together they give the derivative by W and b of every row, without another look at the module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor
from torch.autograd.graph import GradientEdge, Node, get_gradient_edge

# Name of a product's node: where the left factor is saved; which input is the right factor; which one is added.
_PRODUCTS: dict[str, tuple[str, int, int | None]] = {
    "AddmmBackward0": ("_saved_mat1", 2, 0),
    "BaddbmmBackward0": ("_saved_batch1", 2, 0),
    "MmBackward0": ("_saved_self", 1, None),
    "BmmBackward0": ("_saved_self", 1, None),
}
_TRANSPOSES = {"TBackward0", "TransposeBackward0"}
_RESHAPES = {
    "ExpandBackward0",
    "ReshapeAliasBackward0",
    "SqueezeBackward0",
    "SqueezeBackward1",
    "UnsafeViewBackward0",
    "UnsqueezeBackward0",
    "ViewBackward0",
}


@dataclass(frozen=True)
class Weights:
    """The parameters of a linear layer, by their places in a list.

    Attributes:
        weight: W, (..., in, out), or (..., out, in) if ``transposed``, as in `torch.nn.Linear`.
        bias: b, with out numbers, or None.
        transposed: how W is stored.
    """

    weight: int
    bias: int | None
    transposed: bool


@dataclass(frozen=True)
class Layer:
    """One use ``z = x W + b`` of some weights.

    Attributes:
        weights: W and b.
        x: (S, B, in), S = 1 without members.
        edge: where the gradient of z arrives.
    """

    weights: Weights
    x: Tensor
    edge: GradientEdge


def find_layers(residuals: Tensor, params: Sequence[Tensor], members: int | None) -> list[Layer] | None:
    """The linear layers between ``params`` and ``residuals``, or None if a parameter enters in any other way.

    What is found is plausible, not proven: that rows do not mix, and that nothing is scaled on the way, is for the
    caller to check.
    """
    search = _Search({get_gradient_edge(p).node: k for k, p in enumerate(params)})
    if residuals.grad_fn is None or not search.claims_all(residuals.grad_fn):
        return None
    nodes = reversed(search.found().items())  # the walk begins at the residuals; this way the last layer comes last
    layers = [_layer(node, w, params, members) for node, w in nodes]
    kept = [layer for layer in layers if layer is not None]
    every = {layer.weights for layer in kept}
    places = [k for w in every for k in (w.weight, w.bias) if k is not None]
    each_parameter_once = len(set(places)) == len(places)
    same_rows = len({layer.x.shape[:2] for layer in kept}) == 1
    return kept if len(kept) == len(layers) and each_parameter_once and same_rows else None


def _layer(node: Node, weights: Weights, params: Sequence[Tensor], members: int | None) -> Layer | None:
    x, W = getattr(node, _PRODUCTS[node.name()][0]).detach(), params[weights.weight]
    if x.ndim != W.ndim or W.ndim != (2 if members is None else 3):
        return None
    if x.shape[-1] != W.shape[-1 if weights.transposed else -2]:
        return None
    if weights.bias is not None and params[weights.bias].numel() * x.shape[-1] != W.numel():
        return None
    return Layer(weights, x if members else x.unsqueeze(0), GradientEdge(node, 0))


class _Search:
    """A walk through the graph that ends in failure at the first parameter which is no weight or bias of a layer."""

    def __init__(self, places: dict[Node, int]):
        self.places = places
        self.matrices: dict[Node, tuple[int, bool]] = {}
        self.biases: dict[Node, int] = {}

    def claims_all(self, root: Node) -> bool:
        seen, todo = {root}, [root]
        while todo:
            for child in self._unclaimed(todo.pop()):
                if child in self.places:
                    return False
                if child not in seen:
                    seen.add(child)
                    todo.append(child)
        return bool(self.matrices) and self.biases.keys() <= self.matrices.keys()

    def found(self) -> dict[Node, Weights]:
        return {node: Weights(k, self.biases.get(node), turned) for node, (k, turned) in self.matrices.items()}

    def _unclaimed(self, node: Node) -> list[Node]:
        """The inputs of a node, less weights and biases, which are noted."""
        inputs = [child for child, _ in node.next_functions]
        if node.name() in _PRODUCTS:
            _, right, added = _PRODUCTS[node.name()]
            matrix = self._parameter(inputs[right])
            if matrix is not None:
                self.matrices[node] = matrix
                inputs[right] = None
                if added is not None and self._is_bias(inputs[added], node):
                    inputs[added] = None
        elif node.name() == "AddBackward0":
            for k, other in ((0, 1), (1, 0)):
                product = _behind(inputs[k], _RESHAPES)
                if product is not None and product.name() in _PRODUCTS and self._is_bias(inputs[other], product):
                    inputs[other] = None
        return [child for child in inputs if child is not None]

    def _is_bias(self, node: Node | None, product: Node) -> bool:
        """Whether a parameter stands here, and it is the product's first; it is noted then."""
        found = self._parameter(node)
        if found is None or product in self.biases:
            return False
        self.biases[product] = found[0]
        return True

    def _parameter(self, node: Node | None) -> tuple[int, bool] | None:
        """Place of the parameter behind transposes and reshapes, and whether it comes out transposed."""
        transposed = False
        while node is not None and node.name() in _TRANSPOSES | _RESHAPES:
            transposed ^= node.name() in _TRANSPOSES
            node = node.next_functions[0][0]
        return (self.places[node], transposed) if node in self.places else None


def _behind(node: Node | None, names: set[str]) -> Node | None:
    while node is not None and node.name() in names:
        node = node.next_functions[0][0]
    return node
