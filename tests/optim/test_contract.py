"""What every torch optimizer promises: groups, state, closures, schedulers, and refusals with clear words."""

from __future__ import annotations

import copy
import io
import re
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.optim import Backprop, DeltaBarDelta, LevenbergMarquardt, Quickprop

RULES = {
    "backprop": lambda p, **k: Backprop(p, **{"lr": 0.1, "momentum": 0.5, **k}),
    "delta-bar-delta": lambda p, **k: DeltaBarDelta(p, **{"lr": 0.1, "momentum": 0.5, **k}),
    "quickprop": lambda p, **k: Quickprop(p, **{"lr": 0.1, **k}),
    "quickprop as printed": lambda p, **k: Quickprop(p, **{"lr": 0.1, "literal": True, **k}),
}
# It moves all weights by one system of equations: one group, mu where the others have lr, residuals for a loss.
ALL = {**RULES, "levenberg-marquardt": lambda p, lr=1e-3: LevenbergMarquardt(p, mu=lr)}
Make = Callable[..., torch.optim.Optimizer]
every_rule = pytest.mark.parametrize("rule", ALL.values(), ids=ALL.keys())
gradient_rules = pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())


def network(dtype: torch.dtype = torch.float64) -> torch.nn.Sequential:
    net = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.Sigmoid(), torch.nn.Linear(4, 2)).double()
    generator = torch.Generator().manual_seed(0)
    for p in net.parameters():
        torch.nn.init.uniform_(p, -1.0, 1.0, generator=generator)
    return net.to(dtype)


def residuals(net: torch.nn.Module) -> Tensor:
    x = torch.linspace(-1.0, 1.0, 15, dtype=next(net.parameters()).dtype).reshape(5, 3)
    return net(x) - x[:, :2].square()


def backward(net: torch.nn.Module) -> Tensor:
    net.zero_grad()
    loss = 0.5 * residuals(net).square().sum()
    loss.backward()
    return loss.detach()


def step(optimizer: torch.optim.Optimizer, closure: Callable[[], Tensor]) -> None:
    """One step on half the sum of squared residuals, by whichever contract the optimizer has."""
    if getattr(optimizer, "wants_residuals", False):
        optimizer.step(closure)
        return
    optimizer.zero_grad()
    (0.5 * closure().square().sum()).backward()
    optimizer.step()


def run(net: torch.nn.Module, optimizer: torch.optim.Optimizer, steps: int) -> list[Tensor]:
    for _ in range(steps):
        step(optimizer, lambda: residuals(net))
    return [p.detach().clone() for p in net.parameters()]


@every_rule
@pytest.mark.parametrize("through_file", [False, True])
def test_a_saved_state_continues_bit_identically(rule: Make, through_file: bool):
    net = network()
    optimizer = rule(net.parameters())
    run(net, optimizer, 20)
    saved: dict[str, Any] = {"net": copy.deepcopy(net.state_dict()), "rule": copy.deepcopy(optimizer.state_dict())}
    if through_file:
        file = io.BytesIO()
        torch.save(saved, file)
        file.seek(0)
        saved = torch.load(file, weights_only=True)
    expected = run(net, optimizer, 20)

    again = network()
    again.load_state_dict(saved["net"])
    fresh = rule(again.parameters(), lr=0.7)  # the saved lr has to win
    fresh.load_state_dict(saved["rule"])
    for a, b in zip(run(again, fresh, 20), expected, strict=True):
        assert torch.equal(a, b)


@gradient_rules
def test_the_state_is_made_at_the_first_step_and_stays_with_the_parameter(rule: Make):
    net = network(torch.float32)
    optimizer = rule(net.parameters())
    assert not optimizer.state
    run(net, optimizer, 1)
    for p in net.parameters():
        tensors = [x for x in optimizer.state[p].values() if isinstance(x, Tensor)]
        assert tensors
        assert {(x.shape, x.dtype, x.device) for x in tensors} == {(p.shape, p.dtype, p.device)}


@gradient_rules
def test_groups_have_their_own_settings(rule: Make):
    """Training two groups in one optimizer is training each in its own."""
    net, twin = network(), network()
    first, last = net[0].parameters(), net[2].parameters()
    together = rule([{"params": first}, {"params": last, "lr": 0.02}])
    assert [g["lr"] for g in together.param_groups] == [0.1, 0.02]
    apart = [rule(twin[0].parameters()), rule(twin[2].parameters(), lr=0.02)]
    for _ in range(10):
        run(net, together, 1)
        backward(twin)
        for optimizer in apart:
            optimizer.step()
    for a, b in zip(net.parameters(), twin.parameters(), strict=True):
        assert torch.equal(a, b)


@every_rule
def test_all_settings_are_defaults_of_every_group(rule: Make):
    optimizer = rule(network().parameters())
    assert set(optimizer.defaults) == set(optimizer.param_groups[0]) - {"params"}


@gradient_rules
def test_the_closure_runs_with_gradients_and_its_loss_comes_back(rule: Make):
    net, twin = network(), network()
    optimizer = rule(net.parameters())
    with torch.no_grad():
        losses = [optimizer.step(lambda: backward(net)) for _ in range(5)]
    plain = rule(twin.parameters())
    assert losses[0] == backward(network())
    for a, b in zip(net.parameters(), run(twin, plain, 5), strict=True):
        assert torch.equal(a, b)
    assert plain.step() is None


@gradient_rules
def test_a_scheduler_sets_the_size_of_the_next_step(rule: Make):
    """From equal histories, a tenth of lr gives a tenth of the part of the step that lr governs."""
    moved = []
    for gamma in (1.0, 0.1):
        w = torch.nn.Parameter(torch.ones(1, dtype=torch.float64))
        optimizer = rule([w], **({"momentum": 0.0} if "momentum" in rule([w]).defaults else {}))
        scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, gamma)
        w.grad = torch.zeros_like(w)
        optimizer.step()  # no slope: no step, and no momentum
        scheduler.step()
        w.grad = torch.ones_like(w)
        optimizer.step()
        moved.append(1.0 - w.item())
    assert moved == pytest.approx([0.1, 0.01], rel=1e-12)


def test_a_warm_up_leaves_the_rates_of_delta_bar_delta_alone():
    w = torch.nn.Parameter(torch.ones(1, dtype=torch.float64))
    optimizer = DeltaBarDelta([w], lr=0.5, kappa=0.25)
    scheduler = torch.optim.lr_scheduler.LinearLR(optimizer, start_factor=0.5, total_iters=1)
    moved = []
    for _ in range(2):
        before = w.item()
        w.grad = torch.ones_like(w)
        optimizer.step()
        scheduler.step()
        moved.append(before - w.item())
    assert moved == pytest.approx([0.25, 0.75], rel=1e-12)  # half of 0.5; then all of 0.5 + 0.25


@gradient_rules
def test_a_stack_of_networks_is_trained_like_each_alone(rule: Make):
    """Parameters with a leading dimension for the seed, the sum of the losses: elementwise rules see no difference."""
    generator = torch.Generator().manual_seed(3)
    starts = torch.rand(4, 3, 2, dtype=torch.float64, generator=generator) - 0.5
    x = torch.linspace(0.0, 1.0, 15, dtype=torch.float64).reshape(5, 3)

    def train(start: Tensor) -> Tensor:
        w = torch.nn.Parameter(start.clone())
        optimizer = rule([w])
        for _ in range(20):
            optimizer.zero_grad()
            torch.sigmoid(x @ w).square().sum().backward()
            optimizer.step()
        return w.detach()

    # Batched and single products may round differently, and quotients of small slopes enlarge that.
    torch.testing.assert_close(train(starts), torch.stack([train(s) for s in starts]), rtol=1e-9, atol=1e-9)


@every_rule
def test_parameters_without_gradient_are_left_alone(rule: Make):
    used, unused = (torch.nn.Parameter(torch.ones(2)) for _ in range(2))
    optimizer = rule([used, unused])
    step(optimizer, lambda: used - 3.0)
    assert not torch.equal(used, torch.ones(2))
    assert torch.equal(unused, torch.ones(2))
    assert unused not in optimizer.state


@every_rule
def test_sparse_gradients_are_refused_before_anything_changes(rule: Make):
    dense, table = torch.nn.Parameter(torch.ones(2)), torch.nn.Embedding(4, 2, sparse=True)
    optimizer = rule([dense, *table.parameters()])
    with pytest.raises(RuntimeError, match="does not support sparse gradients; build the embedding with sparse=False"):
        step(optimizer, lambda: torch.cat([dense, table(torch.tensor([1])).flatten()]))
    assert torch.equal(dense, torch.ones(2))


@gradient_rules
def test_complex_weights_are_pairs_of_real_ones(rule: Make):
    real = torch.nn.Parameter(torch.tensor([[1.0, -2.0], [0.5, 3.0]], dtype=torch.float64))
    z = torch.nn.Parameter(torch.view_as_complex(real.detach().clone()))
    optimizers = [rule([real]), rule([z])]
    for _ in range(6):
        for optimizer, w in zip(optimizers, (real, z), strict=True):
            optimizer.zero_grad()
            (w.abs().square().sum() * 0.7).backward()
            optimizer.step()
    torch.testing.assert_close(torch.view_as_real(z.detach()), real.detach(), rtol=1e-12, atol=1e-12)
    optimizers[1].load_state_dict(copy.deepcopy(optimizers[1].state_dict()))
    optimizers[1].step()


@every_rule
def test_a_step_takes_a_closure_under_no_grad(rule: Make):
    """What a training loop under no_grad hands over is differentiated all the same."""
    net, twin = network(), network()
    optimizer = rule(net.parameters())
    closure = (lambda: residuals(net)) if getattr(optimizer, "wants_residuals", False) else (lambda: backward(net))
    with torch.no_grad():
        for _ in range(3):
            optimizer.step(closure)
    for a, b in zip(net.parameters(), run(twin, rule(twin.parameters()), 3), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("name", ["backprop", "delta-bar-delta", "quickprop"])
def test_float32_follows_float64(name: str):
    """Ten steps from a common start; 1e-4 is 1000 roundings of float32."""
    low, high = network(torch.float32), network()
    a, b = run(low, RULES[name](low.parameters()), 10), run(high, RULES[name](high.parameters()), 10)
    for x, y in zip(a, b, strict=True):
        assert x.dtype == torch.float32
        torch.testing.assert_close(x.double(), y, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "settings", "text"),
    [
        (Backprop, {"lr": -1}, "Invalid learning rate: -1"),
        (Backprop, {"lr": float("nan")}, "Invalid learning rate: nan"),
        (Backprop, {"momentum": 1.0}, "Invalid momentum: 1.0"),
        (DeltaBarDelta, {"lr": float("inf")}, "Invalid learning rate: inf"),
        (DeltaBarDelta, {"kappa": -1}, "Invalid kappa: -1"),
        (DeltaBarDelta, {"phi": 1.5}, "Invalid phi: 1.5"),
        (DeltaBarDelta, {"theta": -0.1}, "Invalid theta: -0.1"),
        (DeltaBarDelta, {"momentum": -0.5}, "Invalid momentum: -0.5"),
        (Quickprop, {"lr": -0.1}, "Invalid learning rate: -0.1"),
        (Quickprop, {"mu": 0.0}, "Invalid mu: 0.0"),
        (Quickprop, {"weight_decay": -1e-4}, "Invalid weight_decay: -0.0001"),
        (Quickprop, {"max_step": 0}, "Invalid max_step: 0"),
        (LevenbergMarquardt, {"mu": -1.0}, "Invalid mu: -1.0"),
        (LevenbergMarquardt, {"increase": 1.0}, "Invalid increase: 1.0"),
        (LevenbergMarquardt, {"decrease": float("inf")}, "Invalid decrease: inf"),
    ],
)
def test_bad_settings_are_refused_for_all_and_for_one_group(kind: Make, settings: dict[str, float], text: str):
    w = torch.nn.Parameter(torch.ones(2))
    needed = {} if kind is LevenbergMarquardt else {"lr": 0.1}
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        kind([w], **{**needed, **settings})
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        kind([{"params": [w], **settings}], **needed)


@every_rule
def test_no_parameters_is_an_error(rule: Make):
    with pytest.raises(ValueError, match="empty parameter list"):
        rule([])


def test_the_rules_are_reached_from_the_package():
    assert ik.optim.Backprop is Backprop
    assert "optim" in dir(ik)
