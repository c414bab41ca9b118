"""Lanes of small networks: unit functions, rules and gradients against numpy and torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numba import njit

from ikgrad import optim
from ikgrad.engine import descent, perceptron, vecmath
from ikgrad.engine.simd import W, load, store

_logistic, _tanh = vecmath.logistic, vecmath.tanh


@njit
def units(x, logistic, tanh):
    for i in range(0, len(x), W):
        store(logistic, i, _logistic(load(x, i)))
        store(tanh, i, _tanh(load(x, i)))


def both(x):
    x = np.ascontiguousarray(x, dtype=np.float64)
    logistic, tanh = np.empty_like(x), np.empty_like(x)
    units(x, logistic, tanh)
    return logistic, tanh


def test_unit_functions_are_exact_to_rounding():
    rng = np.random.default_rng(0)
    tiny = 10.0 ** rng.uniform(-300, 0, 8000) * rng.choice([-1, 1], 8000)
    x = np.concatenate([rng.uniform(-1, 1, 40000), rng.uniform(-40, 40, 40000), rng.uniform(-700, 700, 8000), tiny])
    logistic, tanh = both(x)
    wide = x.astype(np.longdouble)
    for value, true in ((logistic, 1 / (1 + np.exp(-wide))), (tanh, np.tanh(wide))):
        assert np.max(np.abs((value - true) / true)) < 6e-16


def test_unit_functions_saturate():
    logistic, tanh = both([0.0, -0.0, np.inf, -np.inf, 1e300, -1e300, 800.0, -800.0])
    np.testing.assert_array_equal(logistic, [0.5, 0.5, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(tanh, [0.0, 0.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    logistic, tanh = both([37.5, 709.9, -709.9, -708.0, 20.0, -20.0, 5e-324, np.nan])
    assert (logistic[:2] == 1.0).all()
    assert (logistic[2:4] < 1e-300).all()
    assert (logistic[2:4] >= 0.0).all()
    np.testing.assert_array_equal(tanh[4:7], [1.0, -1.0, 5e-324])
    assert np.isnan([logistic[7], tanh[7]]).all()


def applied(rule):
    """The rule of a lane over whole arrays."""

    @njit
    def change(settings, memory, w, g):
        for i in range(0, len(w), W):
            store(w, i, rule(settings, memory, i, len(w), load(w, i), load(g, i)))

    return change


@pytest.mark.parametrize(
    ("rule", "settings", "names", "make"),
    [
        (descent.backprop, (0.1, 0.6), ["momentum_buffer"], lambda p: optim.Backprop(p, 0.1, momentum=0.6)),
        (
            descent.delta_bar_delta,
            (1.0, 0.02, 0.3, 0.6, 0.5),
            ["rate", "trace", "last_step"],
            lambda p: optim.DeltaBarDelta(p, 0.1, kappa=0.02, phi=0.3, theta=0.6, momentum=0.5),
        ),
        (
            descent.quickprop,
            (0.1, 1.6, 0.01, 0.3),
            ["last_step", "last_slope"],
            lambda p: optim.Quickprop(p, 0.1, mu=1.6, weight_decay=0.01, max_step=0.3),
        ),
        (
            descent.printed_quickprop,
            (0.1,),
            ["last_step", "last_slope"],
            lambda p: optim.Quickprop(p, 0.1, literal=True),
        ),
    ],
)
def test_rules_do_to_a_weight_what_the_optimizers_do(rule, settings, names, make):
    """Gradients whose signs turn, stay, repeat and vanish, some infinite or NaN; memories synchronised every step."""
    rng = np.random.default_rng(0)
    hard = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-300, -1e300, 0.25])
    w = rng.normal(size=64)
    parameter = torch.nn.Parameter(torch.from_numpy(w.copy()))
    optimizer = make([parameter])
    memory = np.zeros((len(names), 64))
    if "rate" in names:
        memory[0] = 0.1
    change = applied(rule)
    g = rng.normal(size=64)
    for step in range(200):
        kind = rng.integers(0, 10, 64)
        g = np.where(kind < 5, g * rng.uniform(-0.5, 1.5, 64), np.where(kind == 5, g, rng.normal(size=64)))
        g[kind == 6] = 0.0
        if step >= 100:
            g[:8] = rng.permutation(hard)
        parameter.grad = torch.from_numpy(g.copy())
        optimizer.step()
        change(settings, memory.reshape(-1), w, g)
        state = optimizer.state[parameter]
        expected = [parameter.detach().numpy(), *(state[name].numpy() for name in names)]
        for ours, torchs in zip([w, *memory], expected, strict=True):
            np.testing.assert_allclose(ours, torchs, rtol=1e-13, atol=1e-15)
            ours[:] = torchs
        if step >= 150:  # the lost lanes begin anew
            with torch.no_grad():
                for array, tensor in zip([w, *memory], [parameter, *(state[name] for name in names)], strict=True):
                    array[~np.isfinite(array)] = 0.1
                    tensor.copy_(torch.from_numpy(array))


@pytest.mark.parametrize("sizes", [(3, 2), (3, 10, 6), (5, 30, 3), (2, 3, 4, 5, 1), (1, 1, 1)])
@pytest.mark.parametrize("names", [("tanh", "linear"), ("logistic", "tanh"), ("relu", "logistic")])
def test_one_step_follows_the_gradient_of_autograd(sizes, names):
    members, patterns = 11, 4
    rng = np.random.default_rng(0)
    count = perceptron.parameters(sizes)
    weights = rng.normal(size=(members, count))
    data = rng.normal(size=(members, patterns, sizes[-1] + sizes[0]))
    activations = [names[0]] * (len(sizes) - 2) + [names[1]]
    after, _ = perceptron.train(
        "backprop", (1.0, 0.0), sizes, activations, weights, np.empty((0, members, count)), data,
        epochs=1, batch_size=patterns,
    )  # fmt: skip
    parameters = torch.tensor(weights, requires_grad=True)
    target, y = torch.tensor(data).split([sizes[-1], sizes[0]], -1)
    functions = {"tanh": torch.tanh, "logistic": torch.sigmoid, "relu": torch.relu, "linear": lambda z: z}
    begin = 0
    for inputs, outputs, name in zip(sizes, sizes[1:], activations, strict=False):
        end = begin + (inputs + 1) * outputs
        matrix = parameters[:, begin:end].reshape(members, inputs + 1, outputs)
        y = functions[name](y @ matrix[:, :-1] + matrix[:, -1:])
        begin = end
    (0.5 * (y - target).square().sum()).backward()
    np.testing.assert_allclose(weights - after, parameters.grad.numpy(), rtol=1e-12, atol=1e-13)


def test_inputs_are_left_alone_and_orders_are_followed():
    sizes, rng = (2, 3, 1), np.random.default_rng(0)
    count = perceptron.parameters(sizes)
    weights, memory = rng.normal(size=(3, count)), rng.normal(size=(1, 3, count))
    data, order = rng.normal(size=(1, 5, 3)), np.argsort(rng.random((4, 3, 5)), -1)
    copies = [array.copy() for array in (weights, memory, data, order)]
    settings = ("backprop", (0.1, 0.5), sizes, ["tanh", "linear"])
    w, m = perceptron.train(*settings, weights, memory, data, order, epochs=4, batch_size=1)
    for array, copy in zip((weights, memory, data, order), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    for k in range(3):
        ours_w, ours_m = weights[k : k + 1], memory[:, k : k + 1]
        for epoch in order[:, k]:
            ours_w, ours_m = perceptron.train(*settings, ours_w, ours_m, data[:, epoch], epochs=1, batch_size=1)
        np.testing.assert_array_equal(w[k], ours_w[0])
        np.testing.assert_array_equal(m[:, k], ours_m[:, 0])
