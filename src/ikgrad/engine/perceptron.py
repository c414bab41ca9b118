"""Training small multilayer perceptrons: whole epochs in one call, eight networks side by side in every register.

A lane is a network; lanes never mix, and every number of a network depends on its own numbers alone. Forward,
backward and the change of the weights go through memory that fits the first-level cache. In online learning a weight
is read once, used for the delta of the layer below, changed and written.

Layout: the parameters of a layer are the rows of a matrix (inputs + 1, outputs), the last row the biases; layers stand
one after the other. For the kernel each number becomes eight, one a network.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.descent import backprop, delta_bar_delta, printed_quickprop, quickprop
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.simd import W, ahead, load, load_rows, peek, pointer, select, splat, store
from ikgrad.engine.vecmath import logistic, tanh

Array = NDArray[np.float64]
ACTIVATIONS = {"linear": 0, "logistic": 1, "tanh": 2, "relu": 3}
_FIXED = np.empty(0, dtype=np.int64)


def train(
    rule: str,
    settings: Sequence[float],
    sizes: Sequence[int],
    activations: Sequence[str],
    weights: Array,
    memory: Array,
    data: Array,
    order: NDArray[np.int64] | None = None,
    *,
    epochs: int,
    batch_size: int,
    threads: int = 1,
) -> tuple[Array, Array]:
    """Train S networks on half the squared error sum for some epochs.

    Args:
        rule: one of `RULES`.
        settings: of the rule, see `ikgrad.engine.descent`.
        sizes: units of each layer, inputs first.
        activations: of each layer but the first, from `ACTIVATIONS`.
        weights: (S, P) all parameters of each network, see the layout above.
        memory: (Q, S, P) the rule's quantities.
        data: (1, N, outputs + inputs), or (S, N, outputs + inputs) with data for each network; targets come first.
        order: (epochs, 1, N) or (epochs, S, N) which pattern is shown when; None: as they stand.
        epochs: how many.
        batch_size: patterns a step.
        threads: threads to use; each trains eight networks at a time.

    Returns:
        weights and memory afterwards. They do not depend on threads, on how epochs are split over calls, or on what a
        network is stacked with.
    """
    members, count = weights.shape
    groups = -(-members // W)
    w, m = _to_lanes(weights[None]), _to_lanes(memory)
    own, patterns = int(len(data) > 1), data.shape[1]
    orders = 0 if order is None else order.shape[1]
    shape = (epochs, patterns, batch_size, members, own, orders, len(memory), count, max(sizes))
    shown = _FIXED if order is None else np.ascontiguousarray(order).reshape(-1)
    kinds = np.array([ACTIVATIONS[name] for name in activations])
    units, flat = np.array(sizes), np.ascontiguousarray(data).reshape(-1)
    scratch_size = W * (count + sum(sizes) + sizes[-1] + 2 * max(sizes))
    run, values = prepare(RULES[rule]), tuple(map(float, settings))

    def work(a: int, b: int) -> None:
        run(values, units, kinds, w, m, flat, shown, shape, np.empty(scratch_size), a, b)

    for_chunks(work, groups, 1, threads)
    return _from_lanes(w, (1, members, count))[0], _from_lanes(m, memory.shape)


def parameters(sizes: Sequence[int]) -> int:
    """Weights and biases of one network."""
    return sum((a + 1) * b for a, b in pairwise(sizes))


def _to_lanes(numbers: Array) -> Array:
    """(Q, S, P) -> flat (groups, Q, P, 8), the last group filled up with zeros."""
    quantities, members, count = numbers.shape
    groups = -(-members // W)
    padded = np.zeros((quantities, groups * W, count))
    padded[:, :members] = numbers
    return np.ascontiguousarray(padded.reshape(quantities, groups, W, count).transpose(1, 0, 3, 2)).reshape(-1)


def _from_lanes(lanes: Array, shape: tuple[int, ...]) -> Array:
    quantities, members, count = shape
    groups = -(-members // W)
    blocks = lanes.reshape(groups, quantities, count, W).transpose(1, 0, 3, 2)
    return blocks.reshape(quantities, groups * W, count)[:, :members]


@njit(forceinline=True)
def _activate(kind: Any, z: Any) -> Any:
    if kind == 1:
        return logistic(z)
    if kind == 2:
        return tanh(z)
    if kind == 3:
        return select(z < 0.0, 0.0, z)
    return z


@njit(forceinline=True)
def _times_slope(kind: Any, grad: Any, y: Any) -> Any:
    """dE/dz from dE/dy."""
    if kind == 1:
        return grad * (1.0 - y) * y
    if kind == 2:
        return grad * (1.0 - y * y)
    if kind == 3:
        return select(y > 0.0, grad, grad * 0.0)
    return grad


@njit(forceinline=True)
def _show(
    data: Any, order: Any, shape: Any, group: Any, epoch: Any, pattern: Any, width: Any, rows: Any, y: Any
) -> Any:
    """Put what each of the eight networks is to see now into ``y``: targets, then inputs."""
    _, patterns, _, members, own, orders, _, _, _ = shape
    for lane in range(W):
        member = min(group * W + lane, members - 1)
        index = pattern
        if orders > 0:
            index = peek(order, (epoch * orders + member % orders) * patterns + pattern)
        rows[lane] = (member * own * patterns + index) * width
    for i in range(width):
        store(y, i * W, load_rows(data, rows, i))


@njit(forceinline=True)
def _forward(layers: Any, sizes: Any, kinds: Any, w: Any, y: Any) -> Any:
    """Answers of all layers, one after the other, from the inputs at ``y``; returns where the last layer's stand."""
    for layer in range(layers):
        inputs, outputs = peek(sizes, layer), peek(sizes, layer + 1)
        answer = ahead(y, inputs * W)
        for j in range(outputs):
            z = load(w, (inputs * outputs + j) * W)
            for i in range(inputs):
                z = z + load(w, (i * outputs + j) * W) * load(y, i * W)
            store(answer, j * W, _activate(peek(kinds, layer), z))
        w = ahead(w, (inputs + 1) * outputs * W)
        y = answer
    return y


@njit(forceinline=True)
def _learn(
    rule: Any, settings: Any, w: Any, memory: Any, sums: Any, at: Any, size: Any, turn: Any, old: Any, g: Any
) -> Any:
    """One weight: add its gradient to the batch's, and at the end of the batch change it."""
    first, last = turn
    if not first:
        g = load(sums, at) + g
    if last:
        store(w, at, rule(settings, memory, at, size, old, g))
    else:
        store(sums, at, g)


@njit(forceinline=True)
def _backward(
    rule: Any, settings: Any, layers: Any, sizes: Any, kinds: Any, w: Any, memory: Any, sums: Any, size: Any, turn: Any,
    y: Any, delta: Any, spare: Any,
) -> Any:  # fmt: skip
    """From the last layer down: ``delta`` is dE/dz of the layer above, ``y`` points to its answers."""
    at = size
    for layer in range(layers - 1, -1, -1):
        inputs, outputs = peek(sizes, layer), peek(sizes, layer + 1)
        at -= (inputs + 1) * outputs * W
        y = ahead(y, -inputs * W)
        for i in range(inputs):
            x, back = load(y, i * W), splat(0.0)
            for j in range(outputs):
                k = at + (i * outputs + j) * W
                old, d = load(w, k), load(delta, j * W)
                back = back + old * d
                _learn(rule, settings, w, memory, sums, k, size, turn, old, x * d)
            if layer > 0:
                store(spare, i * W, _times_slope(peek(kinds, layer - 1), back, x))
        for j in range(outputs):
            k = at + (inputs * outputs + j) * W
            _learn(rule, settings, w, memory, sums, k, size, turn, load(w, k), load(delta, j * W))
        delta, spare = spare, delta


@njit(forceinline=True)
def _train(
    rule: Any, settings: Any, sizes: Any, kinds: Any, w: Any, memory: Any, data: Any, order: Any, shape: Any,
    scratch: Any, rows: Any, begin: Any, end: Any,
) -> Any:  # fmt: skip
    """Epochs for the groups begin..end, each of eight networks."""
    epochs, patterns, batch, _, _, _, quantities, count, widest = shape
    layers, size = len(kinds), count * W
    sizes, kinds, data, order = pointer(sizes), pointer(kinds), pointer(data), pointer(order)
    w, memory, sums = pointer(w), pointer(memory), pointer(scratch)
    inputs, outputs, delta = peek(sizes, 0), peek(sizes, layers), ahead(sums, size)
    spare, y = ahead(delta, widest * W), ahead(delta, 2 * widest * W)
    for group in range(begin, end):
        own_w, own_memory = ahead(w, group * size), ahead(memory, group * size * quantities)
        for epoch in range(epochs):
            for pattern in range(patterns):
                _show(data, order, shape, group, epoch, pattern, inputs + outputs, rows, y)
                answer = _forward(layers, sizes, kinds, own_w, ahead(y, outputs * W))
                for j in range(outputs):
                    o = load(answer, j * W)
                    store(delta, j * W, _times_slope(peek(kinds, layers - 1), o - load(y, j * W), o))
                turn = pattern % batch == 0, pattern % batch == batch - 1 or pattern == patterns - 1
                _backward(
                    rule, settings, layers, sizes, kinds, own_w, own_memory, sums, size, turn, answer, delta, spare
                )


@kernel
def train_backprop(settings, sizes, kinds, w, memory, data, order, shape, scratch, begin, end):  # type: ignore[no-untyped-def]
    """Whole epochs of `backprop` for the groups begin..end."""
    rows = np.empty(W, dtype=np.int64)
    _train(backprop, settings, sizes, kinds, w, memory, data, order, shape, scratch, rows, begin, end)


@kernel
def train_delta_bar_delta(settings, sizes, kinds, w, memory, data, order, shape, scratch, begin, end):  # type: ignore[no-untyped-def]
    """Whole epochs of `delta_bar_delta` for the groups begin..end."""
    rows = np.empty(W, dtype=np.int64)
    _train(delta_bar_delta, settings, sizes, kinds, w, memory, data, order, shape, scratch, rows, begin, end)


@kernel
def train_quickprop(settings, sizes, kinds, w, memory, data, order, shape, scratch, begin, end):  # type: ignore[no-untyped-def]
    """Whole epochs of `quickprop` for the groups begin..end."""
    rows = np.empty(W, dtype=np.int64)
    _train(quickprop, settings, sizes, kinds, w, memory, data, order, shape, scratch, rows, begin, end)


@kernel
def train_printed_quickprop(settings, sizes, kinds, w, memory, data, order, shape, scratch, begin, end):  # type: ignore[no-untyped-def]
    """Whole epochs of `printed_quickprop` for the groups begin..end."""
    rows = np.empty(W, dtype=np.int64)
    _train(printed_quickprop, settings, sizes, kinds, w, memory, data, order, shape, scratch, rows, begin, end)


RULES = {
    "backprop": train_backprop,
    "delta_bar_delta": train_delta_bar_delta,
    "quickprop": train_quickprop,
    "printed_quickprop": train_printed_quickprop,
}
