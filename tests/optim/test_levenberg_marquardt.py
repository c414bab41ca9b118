"""Levenberg-Marquardt: Jacobian against torch.func, steps against the textbook, what a failure leaves behind."""

from __future__ import annotations

import copy
import io
import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.func import functional_call, jacrev

import ikgrad as ik
from ikgrad.errors import ShapeError, TrainingError
from ikgrad.networks import MLP
from ikgrad.optim import LevenbergMarquardt
from ikgrad.optim import normal_equations as ways
from ikgrad.optim.normal_equations import normal_equations


class Twice(nn.Module):
    """The same weights used two times, as in a rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.inner, self.outer = nn.Linear(3, 3), nn.Linear(3, 2)

    def forward(self, x: Tensor) -> Tensor:
        return self.outer(torch.tanh(self.inner(torch.tanh(self.inner(x)))))


class Frozen(nn.Module):
    """A trained bias behind a product whose weights are not trained."""

    def __init__(self) -> None:
        super().__init__()
        self.bias, self.last = nn.Parameter(torch.ones(4)), nn.Linear(4, 2)

    def forward(self, x: Tensor) -> Tensor:
        return self.last(torch.tanh(x @ torch.ones(3, 4, dtype=x.dtype) + self.bias))


BY_LAYERS: dict[str, Callable[[], nn.Module]] = {
    "linear": lambda: nn.Sequential(
        nn.Linear(3, 5), nn.Tanh(), nn.Linear(5, 4, bias=False), nn.SiLU(), nn.Linear(4, 2)
    ),
    "mlp": lambda: MLP((3, 5, 2), output="tanh"),
    "twice": Twice,
}
OTHERWISE: dict[str, Callable[[], nn.Module]] = {
    "rows mix": lambda: nn.Sequential(nn.Linear(3, 5), nn.Softmax(0), nn.Linear(5, 2)),
    "layer norm": lambda: nn.Sequential(nn.Linear(3, 4), nn.LayerNorm(4), nn.Linear(4, 2)),
    "frozen": Frozen,
}
RESIDUALS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "plain": lambda out, y: out - y,
    "flat": lambda out, y: (out - y).sin().flatten(),
    "wider": lambda out, y: torch.cat([out - y, out[:, :1] * out[:, 1:]], 1),
    "batch last": lambda out, y: (out - y).mT,
}


def made(make: Callable[[], nn.Module]) -> nn.Module:
    net = make().double()
    generator = torch.Generator().manual_seed(0)
    for p in net.parameters():
        nn.init.uniform_(p, -1.0, 1.0, generator=generator)
    return net


def data(count: int = 20) -> tuple[Tensor, Tensor]:
    x = torch.linspace(-1.0, 1.0, 3 * count, dtype=torch.float64).mul(3.0).sin().reshape(count, 3)
    return x, torch.stack([x.prod(1), x.square().mean(1)], 1)


def dense(net: nn.Module, residuals: Callable[[nn.Module, dict[str, Tensor]], Tensor]) -> Tensor:
    """(N, P) from torch.func, parameters in their order."""
    params = {k: v.detach() for k, v in net.named_parameters()}
    J = jacrev(lambda p: residuals(net, p).reshape(-1))(params)
    return torch.cat([J[k].flatten(1) for k in params], 1)


def damped_step(J: Tensor, r: Tensor, mu: float) -> Tensor:
    return -torch.linalg.solve(J.mT @ J + mu * torch.eye(J.shape[1], dtype=J.dtype), J.mT @ r.reshape(-1))


def our_step(r: Tensor, params: list[nn.Parameter], mu: float) -> Tensor:
    found = normal_equations(r, params, None)
    H = found.matrix[0].tril() + found.matrix[0].tril(-1).mT
    d = -torch.linalg.solve(H + mu * torch.eye(len(H), dtype=H.dtype), found.gradient[0])
    return torch.cat([part.flatten() for part in found.split(d[None])])


def forbid(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a slower way was taken")

    for name in names:
        monkeypatch.setattr(ways, name, refuse)


@pytest.mark.parametrize("residuals", list(RESIDUALS)[:3])
@pytest.mark.parametrize("net", BY_LAYERS)
def test_linear_layers_are_recognised_and_give_the_exact_step(
    net: str, residuals: str, monkeypatch: pytest.MonkeyPatch
):
    forbid(monkeypatch, "_by_rows", "_by_columns")
    check_step(made(BY_LAYERS[net]), RESIDUALS[residuals])


@pytest.mark.parametrize("residuals", RESIDUALS)
@pytest.mark.parametrize("net", OTHERWISE)
def test_what_layers_cannot_explain_is_right_all_the_same(net: str, residuals: str):
    check_step(made(OTHERWISE[net]), RESIDUALS[residuals])


def test_rows_in_another_order_are_noticed():
    check_step(made(BY_LAYERS["linear"]), RESIDUALS["batch last"])


def check_step(net: nn.Module, residuals: Callable[[Tensor, Tensor], Tensor]) -> None:
    x, y = data()
    J = dense(net, lambda net, p: residuals(functional_call(net, p, (x,)), y))
    r = residuals(net(x), y)
    expected = damped_step(J, r.detach(), 0.1)
    torch.testing.assert_close(our_step(r, list(net.parameters()), 0.1), expected, rtol=1e-10, atol=1e-10)


def test_few_weights_go_by_columns(monkeypatch: pytest.MonkeyPatch):
    forbid(monkeypatch, "_by_rows")
    t = torch.linspace(0.0, 1.0, 30, dtype=torch.float64)
    w = nn.Parameter(torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64))
    J = torch.stack([(w[1] * t).exp(), w[0] * t * (w[1] * t).exp(), torch.ones_like(t)], 1).detach()
    r = w[0] * (w[1] * t).exp() + w[2]
    torch.testing.assert_close(our_step(r, [w], 0.1), damped_step(J, r.detach(), 0.1), rtol=1e-10, atol=1e-10)


class CubeOnce(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return x**3

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        return 3.0 * ctx.saved_tensors[0] ** 2 * grad


def test_a_function_that_cannot_be_differentiated_twice_goes_by_rows():
    t = torch.linspace(0.5, 1.0, 9, dtype=torch.float64)
    w = nn.Parameter(torch.tensor([2.0], dtype=torch.float64))
    r = CubeOnce.apply(w * t)
    J = (3.0 * w.detach() ** 2 * t**3)[:, None]
    torch.testing.assert_close(our_step(r, [w], 0.1), damped_step(J, r.detach(), 0.1), rtol=1e-12, atol=1e-12)


def textbook(net: nn.Module, steps: int) -> tuple[Tensor, float]:
    """Hagan and Menhaj (1994) with a dense Jacobian."""
    (x, y), mu = data(), 1e-3
    w = nn.utils.parameters_to_vector(net.parameters()).detach().clone()

    def residuals(w: Tensor) -> Tensor:
        nn.utils.vector_to_parameters(w, net.parameters())
        return (net(x) - y).detach()

    for _ in range(steps):
        r = residuals(w)
        J = dense(net, lambda net, p: functional_call(net, p, (x,)) - y)
        while mu <= 1e10:
            trial = w + damped_step(J, r, mu)
            if residuals(trial).square().sum() < r.square().sum():
                w, mu = trial, mu / 10.0
                break
            mu *= 10.0
        residuals(w)
    return w, mu


def train(net: nn.Module, optimizer: LevenbergMarquardt, steps: int) -> list[Tensor]:
    x, y = data()
    return [optimizer.step(lambda: net(x) - y) for _ in range(steps)]


def test_steps_are_those_of_the_textbook():
    net, twin = made(BY_LAYERS["linear"]), made(BY_LAYERS["linear"])
    optimizer = LevenbergMarquardt(net.parameters())
    losses = train(net, optimizer, 8)
    w, mu = textbook(twin, 8)
    # Small mu divides roundings by small eigenvalues of J^T J.
    torch.testing.assert_close(nn.utils.parameters_to_vector(net.parameters()).detach(), w, rtol=1e-6, atol=1e-6)
    assert optimizer.mu.item() == pytest.approx(mu, rel=1e-12)
    assert all(b < a for a, b in pairwise(losses))
    x, y = data()
    assert losses[-1].item() == pytest.approx((net(x) - y).square().sum().item(), rel=1e-12)


def test_members_are_trained_like_each_alone():
    x, y = data()
    stack = MLP((3, 4, 2), members=3, seeds=range(3))
    alone = [stack.member(k) for k in range(3)]
    together = LevenbergMarquardt(stack.parameters(), members=3)
    single = [LevenbergMarquardt(net.parameters()) for net in alone]
    for _ in range(6):
        losses = together.step(lambda: stack(x) - y)
        expected = torch.stack([o.step(lambda n=n: n(x) - y) for o, n in zip(single, alone, strict=True)])
        torch.testing.assert_close(losses, expected, rtol=1e-7, atol=1e-12)
        torch.testing.assert_close(together.mu, torch.stack([o.mu for o in single]), rtol=1e-12, atol=0.0)
        assert together.tries.tolist() == [o.tries.item() for o in single]


def test_a_member_that_is_not_finite_does_not_disturb_the_others():
    x, y = data()
    stack, twin = (MLP((3, 4, 2), members=3, seeds=range(3)) for _ in range(2))
    bad = torch.ones(3, 1, 1, dtype=torch.float64)
    bad[1] = torch.nan
    optimizer = LevenbergMarquardt(stack.parameters(), members=3)
    losses = optimizer.step(lambda: (stack(x) - y) * bad)
    assert optimizer.stopped.tolist() == [False, True, False]
    expected = LevenbergMarquardt(twin.parameters(), members=3).step(lambda: twin(x) - y)
    torch.testing.assert_close(losses[[0, 2]], expected[[0, 2]], rtol=1e-12, atol=0.0)
    for p, start in zip(stack.parameters(), MLP((3, 4, 2), members=3, seeds=range(3)).parameters(), strict=True):
        assert torch.equal(p[1], start[1])


def test_a_step_that_gives_up_leaves_the_weights_bit_for_bit():
    start = torch.tensor([1.0, -0.0, 1e-310], dtype=torch.float64)
    w = nn.Parameter(start.clone())
    optimizer = LevenbergMarquardt([w])
    loss = optimizer.step(lambda: torch.where(w == start, w, w + 10.0))
    assert torch.equal(w.detach().view(torch.int64), start.view(torch.int64))
    assert loss == 1.0
    assert optimizer.stopped
    assert optimizer.mu > 1e10
    assert optimizer.tries.item() >= 13  # 1e-3 to 1e10
    optimizer.step(lambda: w - 2.0)  # begins with mu_max, and may succeed
    assert not optimizer.stopped
    assert optimizer.mu.item() == pytest.approx(1e9)


def test_an_error_in_a_try_leaves_the_weights_as_they_were():
    w = nn.Parameter(torch.tensor([1.0, 2.0]))
    calls = []

    def closure() -> Tensor:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return w * 3.0

    with pytest.raises(KeyboardInterrupt):
        LevenbergMarquardt([w]).step(closure)
    assert w.tolist() == [1.0, 2.0]


def test_tries_that_are_not_finite_are_rejected():
    w = nn.Parameter(torch.tensor([3.0], dtype=torch.float64))
    optimizer = LevenbergMarquardt([w])
    optimizer.step(w.log)  # the full step ends below zero
    assert optimizer.tries.item() > 1
    for _ in range(10):
        optimizer.step(w.log)
    assert w.item() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("r", [lambda w: w / 0.0, lambda w: w.sqrt()], ids=["residuals", "derivatives"])
def test_a_start_that_is_not_finite_is_an_error(r: Callable[[Tensor], Tensor]):
    w = nn.Parameter(torch.zeros(2))
    with pytest.raises(TrainingError, match="not finite at the present weights"):
        LevenbergMarquardt([w]).step(lambda: r(w))
    assert w.tolist() == [0.0, 0.0]


def test_a_singular_system_that_damping_cannot_cure_is_solved_by_its_eigenvalues():
    """J^T J is 1e18 in every place: 1e-2 is lost in it and the second pivot of Cholesky is zero."""
    w = nn.Parameter(torch.zeros(2, dtype=torch.float64))
    optimizer = LevenbergMarquardt([w], mu_max=1e-2)
    assert optimizer.step(lambda: 1e9 * (w.sum() - 1.0).reshape(1)) < 1.0  # from 1e18
    assert not optimizer.stopped


def test_other_parameters_and_gradients_are_left_alone():
    used, unused, frozen = (nn.Parameter(torch.ones(2)) for _ in range(3))
    frozen.requires_grad_(False)
    used.grad = torch.full((2,), 7.0)
    LevenbergMarquardt([used, unused, frozen]).step(lambda: used * frozen - 3.0)
    assert used.grad.tolist() == [7.0, 7.0]
    assert unused.tolist() == frozen.tolist() == [1.0, 1.0]
    assert used.tolist() == pytest.approx([3.0, 3.0], abs=0.01)


def test_float32_stays_float32():
    x, y = data()
    net = made(BY_LAYERS["linear"]).float()
    optimizer = LevenbergMarquardt(net.parameters())
    losses = [optimizer.step(lambda: net(x.float()) - y.float()) for _ in range(5)]
    assert losses[-1] < 0.1 * losses[0]
    assert {losses[-1].dtype, optimizer.mu.dtype, net[0].weight.dtype} == {torch.float32}


@pytest.mark.parametrize("through_file", [False, True])
def test_a_saved_state_continues_bit_identically(through_file: bool):
    net = made(BY_LAYERS["linear"])
    optimizer = LevenbergMarquardt(net.parameters())
    train(net, optimizer, 4)
    saved: dict[str, Any] = copy.deepcopy({"net": net.state_dict(), "rule": optimizer.state_dict()})
    if through_file:
        file = io.BytesIO()
        torch.save(saved, file)
        file.seek(0)
        saved = torch.load(file, weights_only=True)
    train(net, optimizer, 4)
    again = made(BY_LAYERS["linear"])
    again.load_state_dict(saved["net"])
    fresh = LevenbergMarquardt(again.parameters(), mu=7.0, increase=2.0)  # the saved settings have to win
    fresh.load_state_dict(saved["rule"])
    train(again, fresh, 4)
    assert torch.equal(fresh.mu, optimizer.mu)
    for a, b in zip(again.parameters(), net.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"mu": 0.0}, "Invalid mu: 0.0"),
        ({"mu": float("nan")}, "Invalid mu: nan"),
        ({"decrease": 0.5}, "Invalid decrease: 0.5"),
        ({"increase": 1.0}, "Invalid increase: 1.0"),
        ({"mu_max": 1e-4}, "Invalid mu_max: 0.0001"),
        ({"members": 0}, "Invalid members: 0"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], text: str):
    w = nn.Parameter(torch.ones(2))
    for build in (
        lambda: LevenbergMarquardt([w], **settings),
        lambda: LevenbergMarquardt([{"params": [w], **settings}]),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
            build()


def test_parameters_that_do_not_fit_are_refused():
    w = nn.Parameter(torch.ones(2))
    with pytest.raises(ValueError, match="takes one group"):
        LevenbergMarquardt([{"params": [w]}, {"params": [nn.Parameter(torch.ones(1))]}])
    with pytest.raises(ValueError, match="complex parameters"):
        LevenbergMarquardt([nn.Parameter(torch.ones(1, dtype=torch.complex64))])
    with pytest.raises(ValueError, match="one dtype on one device"):
        LevenbergMarquardt([w, nn.Parameter(torch.ones(1).double())])
    with pytest.raises(ValueError, match=r"of 3 members must have shape \(3, ...\), got \(2,\)"):
        LevenbergMarquardt([w], members=3)


@pytest.mark.parametrize(
    ("closure", "error", "text"),
    [
        (lambda w: w.square().sum(), ShapeError, r"not their loss; got shape \(\)"),
        (lambda w: w[:0], ShapeError, r"got shape \(0,\)"),
        (lambda w: w * 1j, ShapeError, "got complex shape"),
        (lambda w: 1.0, ShapeError, "as a tensor, got float"),
        (lambda w: w.detach(), RuntimeError, "do not depend on the parameters"),
    ],
)
def test_bad_residuals_are_refused(closure: Callable[[Tensor], Any], error: type[Exception], text: str):
    w = nn.Parameter(torch.ones(2))
    with pytest.raises(error, match=text):
        LevenbergMarquardt([w]).step(lambda: closure(w))
    assert w.tolist() == [1.0, 1.0]


def test_residuals_of_other_than_the_members_are_refused():
    w = nn.Parameter(torch.ones(2, 3))
    with pytest.raises(ShapeError, match=r"residuals of 2 members must have shape \(2, ...\), got \(3, 2\)"):
        LevenbergMarquardt([w], members=2).step(lambda: w.mT)


def test_sparse_gradients_are_refused():
    table = nn.Embedding(4, 2, sparse=True)
    with pytest.raises(RuntimeError, match="does not support sparse gradients; build the embedding with sparse=False"):
        LevenbergMarquardt(table.parameters()).step(lambda: table(torch.tensor([1])))


def test_it_is_reached_from_the_package_and_is_not_the_solver():
    assert ik.optim.LevenbergMarquardt is LevenbergMarquardt
    assert ik.LevenbergMarquardt is not LevenbergMarquardt
