"""The perceptron: its gradient, its stacks, its errors."""

from __future__ import annotations

import pytest
import torch

from ikgrad.errors import DataError, ShapeError, UnknownNameError
from ikgrad.networks import ACTIVATIONS, MLP, MinMax

KNOWN = [name for name, activation in ACTIVATIONS.items() if activation.backward is not None]


def patterns(count: int, inputs: int, outputs: int, *, members: int | None = None, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    lead = () if members is None else (members,)
    x = torch.randn(*lead, count, inputs, dtype=torch.float64, generator=generator)
    return x, torch.rand(*lead, count, outputs, dtype=torch.float64, generator=generator)


@pytest.mark.parametrize("sizes", [(3, 10, 6), (2, 4, 5, 1), (4, 2)], ids=str)
@pytest.mark.parametrize("members", [None, 1, 3])
@pytest.mark.parametrize("count", [1, 9])
@pytest.mark.parametrize("hidden", KNOWN)
@pytest.mark.parametrize("output", ["logistic", "linear"])
def test_backpropagation_equals_autograd(sizes, members, count, hidden, output):
    seeds = 0 if members is None else range(members)
    net = MLP(sizes, hidden=hidden, output=output, members=members, seeds=seeds)
    x, d = patterns(count, sizes[0], sizes[-1], members=members)
    (0.5 * (net(x) - d).square().sum()).backward()
    expected = [parameter.grad.clone() for parameter in net.parameters()]
    error = net.backpropagate(x, d)
    torch.testing.assert_close(error, net(x).detach() - d, rtol=0.0, atol=1e-15)
    for parameter, grad in zip(net.parameters(), expected, strict=True):
        assert parameter.grad.shape == parameter.shape
        torch.testing.assert_close(parameter.grad, grad, rtol=0.0, atol=1e-10)


def test_only_autograd_knows_some_activations():
    assert not MLP((2, 2, 2), hidden="gelu").knows_its_gradient
    assert MLP((2, 2, 2), hidden="relu").knows_its_gradient


def test_members_answer_as_they_would_alone():
    stack = MLP((3, 10, 6), members=4, seeds=[5, 6, 7, 8])
    x, _ = patterns(9, 3, 6)
    for k in range(4):
        alone = MLP((3, 10, 6), seeds=5 + k)
        torch.testing.assert_close(stack(x)[k], alone(x), rtol=0.0, atol=1e-14)
        assert all(torch.equal(a, b) for a, b in zip(stack.member(k).parameters(), alone.parameters(), strict=True))


def test_members_have_data_of_their_own():
    stack = MLP((3, 4, 2), members=2, seeds=[0, 1])
    x, _ = patterns(5, 3, 2, members=2)
    torch.testing.assert_close(stack(x)[1], stack.member(1)(x[1]), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("bound", [None, 0.5])
def test_first_weights_stay_inside_their_bound(bound):
    net = MLP((100, 400, 1), seeds=3, bound=bound)
    for parameter, units in zip(net.weights, (100, 400), strict=True):
        limit = bound or units**-0.5
        assert parameter.abs().max() <= limit
        assert parameter.abs().max() > 0.97 * limit
        assert abs(parameter.mean()) < 0.1 * limit


def test_any_batch_of_a_single_network():
    net = MLP((3, 4, 2), dtype=torch.float32)
    for lead in ((), (5,), (2, 1, 5)):
        assert net(torch.zeros(*lead, 3)).shape == (*lead, 2)
        assert net(torch.zeros(*lead, 3)).dtype == torch.float32


def test_a_network_prints_what_it_is():
    assert str(MLP((3, 4, 2), members=2, seeds=[0, 1])).startswith(
        "MLP(\n  3-4-2, hidden=tanh, output=linear, members=2"
    )


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: MLP((3,)), ShapeError, r"sizes must be two or more positive numbers, got \(3,\)"),
        (lambda: MLP((3, 0, 1)), ShapeError, r"positive numbers, got \(3, 0, 1\)"),
        (lambda: MLP((3, 1), members=0), ShapeError, "members must be at least 1, got 0"),
        (lambda: MLP((3, 1), members=2), ShapeError, "seeds must hold 2 numbers, one for each member, got 1"),
        (lambda: MLP((3, 1), hidden="logistik"), UnknownNameError, "unknown activation 'logistik'; did you mean 'logi"),
        (lambda: MLP((3, 1))(torch.zeros(2)), ShapeError, r"x must have shape \(\.\.\., 3\), got \(2,\)"),
        (lambda: MLP((3, 1), members=2, seeds=[0, 1])(torch.zeros(3, 5, 3)), ShapeError, r"\(2, B, n\), got \(3, 5, 3"),
        (lambda: MLP((3, 1)).member(0), ShapeError, "single network"),
    ],
)
def test_mistakes_are_named(make, error, text):
    with pytest.raises(error, match=text):
        make()


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-1.0, 1.0), (0.1, 0.9)])
def test_scaling_maps_ranges_and_comes_back(low, high):
    data, _ = patterns(50, 4, 1, seed=3)
    scale = MinMax(4, low=low, high=high).fit(data)
    scaled = scale(data)
    torch.testing.assert_close(scaled.amin(0), torch.full((4,), low, dtype=torch.float64), rtol=0.0, atol=1e-15)
    torch.testing.assert_close(scaled.amax(0), torch.full((4,), high, dtype=torch.float64), rtol=0.0, atol=1e-15)
    torch.testing.assert_close(scale.inverse(scaled), data, rtol=0.0, atol=1e-14)


def test_a_column_that_never_changes_is_its_constant():
    data = torch.tensor([[1.0, 7.0], [2.0, 7.0]], dtype=torch.float64)
    scale = MinMax(2).fit(data)
    assert scale(data)[:, 1].tolist() == [0.0, 0.0]
    assert scale.inverse(torch.tensor([0.3, 0.9], dtype=torch.float64))[1].item() == 7.0


def test_the_scale_is_saved_with_the_model():
    scale = MinMax(2).fit(torch.tensor([[1.0, 2.0], [5.0, 9.0]], dtype=torch.float64))
    other = MinMax(2)
    other.load_state_dict(scale.state_dict())
    x = torch.ones(2, dtype=torch.float64)
    assert torch.equal(scale(x), other(x))


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: MinMax(2).fit(torch.zeros(3, 4)), ShapeError, r"data must have shape \(\.\.\., 2\), got \(3, 4\)"),
        (lambda: MinMax(2).fit(torch.zeros(0, 2)), DataError, "no rows"),
        (lambda: MinMax(2).fit(torch.tensor([[0.0, 1.0], [torch.nan, 1.0]])), DataError, "row 1, column 0 is nan"),
        (lambda: MinMax(2, low=1.0, high=0.0), ValueError, "low must be below high"),
    ],
)
def test_scaling_refuses(call, error, text):
    with pytest.raises(error, match=text):
        call()
