"""The rules against torch.optim.SGD and against short references, written from the original papers in numpy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from ikgrad.optim import Backprop, DeltaBarDelta, Quickprop

Array = NDArray[np.float64]
STEPS = 200


def data() -> tuple[Tensor, Tensor]:
    x = torch.rand(9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return x, torch.stack([x.prod(1), x.square().mean(1)], 1)


def network() -> torch.nn.Sequential:
    """3-5-2 logistic, 32 weights between -1 and 1."""
    layers = [torch.nn.Linear(3, 5), torch.nn.Sigmoid(), torch.nn.Linear(5, 2), torch.nn.Sigmoid()]
    net = torch.nn.Sequential(*layers).double()
    generator = torch.Generator().manual_seed(1)
    for p in net.parameters():
        torch.nn.init.uniform_(p, -1.0, 1.0, generator=generator)
    return net


def backward(net: torch.nn.Module) -> Tensor:
    x, y = data()
    net.zero_grad()
    loss = 0.5 * (net(x) - y).square().sum()
    loss.backward()
    return loss.detach()


def weights(net: torch.nn.Module) -> Array:
    return torch.nn.utils.parameters_to_vector(net.parameters()).detach().numpy().copy()


def gradient(w: Array) -> Array:
    net = network()
    torch.nn.utils.vector_to_parameters(torch.from_numpy(w.copy()), net.parameters())
    backward(net)
    return torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None]).numpy()


def trajectory(make: Callable[..., torch.optim.Optimizer]) -> Iterator[Array]:
    net = network()
    optimizer = make(net.parameters())
    for _ in range(STEPS):
        backward(net)
        optimizer.step()
        yield weights(net)


def jacobs_1988(lr: float, kappa: float, phi: float, theta: float, momentum: float) -> Iterator[Array]:
    """Delta-bar-delta, weight by weight; momentum as in Rumelhart, Hinton, Williams."""
    w = weights(network())
    rate, bar, last = [lr] * w.size, [0.0] * w.size, [0.0] * w.size
    while True:
        for i, delta in enumerate(gradient(w)):
            if bar[i] * delta > 0:
                rate[i] = rate[i] + kappa
            elif bar[i] * delta < 0:
                rate[i] = rate[i] - phi * rate[i]
            bar[i] = (1 - theta) * delta + theta * bar[i]
            last[i] = -rate[i] * delta + momentum * last[i]
            w[i] += last[i]
        yield w


def fahlman_1988(epsilon: float, mu: float, decay: float) -> Iterator[Array]:
    """Quickprop, weight by weight, with the cases of his program; slope there is the way *down*.

    The order of the factors in the quotient matters: other roundings, enlarged by every parabola, part two
    trajectories by 1e-12 after some 35 steps of this network.
    """
    w = weights(network())
    last_step, last_down = np.zeros_like(w), np.zeros_like(w)
    while True:
        for i, g in enumerate(gradient(w)):
            down, before, d, step = -(g + decay * w[i]), last_down[i], last_step[i], 0.0
            if d == 0.0 or np.sign(down) == np.sign(d):
                step += epsilon * down
            if (d > 0 and down >= mu / (1 + mu) * before) or (d < 0 and down <= mu / (1 + mu) * before):
                step += mu * d
            elif d != 0:
                step += down / (before - down) * d
            w[i], last_step[i], last_down[i] = w[i] + step, step, down
        yield w


def assert_same(got: Iterator[Array], expected: Iterator[Array]) -> None:
    """Both rules work in float64 in nearly the same order: 1e-12 leaves room for 200 steps of rounding."""
    last = None
    for step, (a, b) in enumerate(zip(got, expected, strict=False)):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12, err_msg=f"step {step}")
        last = a
    assert step == STEPS - 1
    assert np.abs(last - weights(network())).max() > 0.5  # it has moved, so the agreement says something


@pytest.mark.parametrize("momentum", [0.0, 0.5, 0.95])
def test_backprop_equals_sgd(momentum: float):
    ours = trajectory(lambda p: Backprop(p, 0.3, momentum=momentum))
    assert_same(ours, trajectory(lambda p: torch.optim.SGD(p, 0.3, momentum=momentum, foreach=False)))


def test_backprop_equals_sgd_under_a_scheduler():
    end = []
    for kind in (Backprop, torch.optim.SGD):
        net = network()
        optimizer = kind(net.parameters(), lr=0.5, momentum=0.9)
        scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
        for _ in range(STEPS):
            backward(net)
            optimizer.step()
            scheduler.step()
        end.append(weights(net))
    np.testing.assert_allclose(*end, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("momentum", [0.0, 0.5])
@pytest.mark.parametrize(("kappa", "phi", "theta"), [(0.01, 0.1, 0.7), (0.1, 0.5, 0.0), (0.0, 0.0, 0.3)])
def test_delta_bar_delta_equals_the_reference(kappa: float, phi: float, theta: float, momentum: float):
    ours = trajectory(lambda p: DeltaBarDelta(p, 0.2, kappa=kappa, phi=phi, theta=theta, momentum=momentum))
    assert_same(ours, jacobs_1988(0.2, kappa, phi, theta, momentum))


@pytest.mark.parametrize(("mu", "decay"), [(1.75, 0.0), (1.75, 1e-4), (1.1, 0.0)])
def test_quickprop_equals_the_reference(mu: float, decay: float):
    ours = trajectory(lambda p: Quickprop(p, 0.05, mu=mu, weight_decay=decay, max_step=math.inf))
    assert_same(ours, fahlman_1988(0.05, mu, decay))


def test_every_case_of_quickprop_occurs_in_the_comparison():
    """Else the agreement would say nothing about the cases that are missing."""
    path = [weights(network()), *(w.copy() for w in trajectory(lambda p: Quickprop(p, 0.05, max_step=math.inf)))]
    slopes = np.array([gradient(w) for w in path[:-1]])
    steps = np.diff(path, axis=0)
    downhill = slopes[1:] * steps[:-1] < 0
    limited = downhill & (np.abs(slopes[1:]) >= 1.75 / 2.75 * np.abs(slopes[:-1]))
    for case in (~downhill, limited, downhill & ~limited):
        assert case.mean() > 0.02


def descend(rule: Callable[..., torch.optim.Optimizer], steps: int) -> float:
    w = torch.nn.Parameter(torch.tensor([1.0], dtype=torch.float64))
    optimizer = rule([w])
    for _ in range(steps):
        optimizer.zero_grad()
        (0.5 * w.square().sum()).backward()
        optimizer.step()
    return abs(w.item())


def test_the_printed_equation_diverges_where_the_corrected_rule_converges():
    """A parabola, lr 1.5. The jump alone would end in the minimum; -lr S(t) on top of it overshoots, every step."""
    assert descend(lambda p: Quickprop(p, 1.5, literal=True), 60) > 1e6
    assert descend(lambda p: Quickprop(p, 1.5, max_step=math.inf), 60) < 1e-12
    assert descend(lambda p: Backprop(p, 1.5), 60) < 1e-12  # plain descent converges up to lr 2


def test_the_printed_equation_diverges_on_a_network():
    """Without a growth limit weights of 1 become 50 and more, the units saturate, and the quotient ends in 0/0."""
    printed, net = list(trajectory(lambda p: Quickprop(p, 0.05, literal=True))), network()
    finite = [np.abs(w).max() for w in printed if np.isfinite(w).all()]
    assert max(finite) > 50.0
    assert len(finite) < STEPS
    first = backward(net)
    for w in trajectory(lambda p: Quickprop(p, 0.05)):
        torch.nn.utils.vector_to_parameters(torch.from_numpy(w), net.parameters())
    assert backward(net) < 0.1 * first


def test_quickprop_survives_slopes_that_vanish_or_stay_equal():
    """S(t-1) = S(t), both also 0: no division by zero; a straight slope gives steps that grow by mu, up to the cap."""
    w = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
    optimizer = Quickprop([w], lr=0.01, max_step=0.1)
    moved = []
    for _ in range(8):
        before = w.detach().clone()
        w.grad = torch.tensor([0.0, 1.0], dtype=torch.float64)
        optimizer.step()
        moved.append((before - w.detach()).tolist())
    assert [a for a, _ in moved] == [0.0] * 8
    assert [b for _, b in moved[:3]] == pytest.approx([0.01, 0.0275, 0.058125])  # 1.75 times the last, plus lr
    assert [b for _, b in moved[3:]] == pytest.approx([0.1] * 5)


def test_delta_bar_delta_compares_signs_of_tiny_gradients():
    """1e-30 times 1e-30 is 0 in float32; the rates must grow all the same."""
    w = torch.nn.Parameter(torch.zeros(1))
    optimizer = DeltaBarDelta([w], lr=1.0, kappa=0.5)
    for _ in range(3):
        w.grad = torch.full_like(w, 1e-30)
        optimizer.step()
    assert optimizer.state[w]["rate"].item() == 2.0
