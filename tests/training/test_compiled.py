"""The compiled kernels train as the torch path does, to rounding, and nothing else about them can be noticed."""

from __future__ import annotations

import copy

import pytest
import torch

from ikgrad import optim
from ikgrad.networks import MLP
from ikgrad.training import Batches, Training, compiled

RULES = {
    "plain backprop": lambda p: optim.Backprop(p, 0.05),
    "backprop": lambda p: optim.Backprop(p, 0.05, momentum=0.5),
    "plain delta-bar-delta": lambda p: optim.DeltaBarDelta(p, 0.05),
    "delta-bar-delta": lambda p: optim.DeltaBarDelta(p, 0.02, kappa=0.002, phi=0.2, theta=0.6, momentum=0.3),
    "quickprop": lambda p: optim.Quickprop(p, 0.05),
    "decaying quickprop": lambda p: optim.Quickprop(p, 0.02, mu=1.5, weight_decay=1e-3, max_step=0.05),
}
LITERAL = {"literal quickprop": lambda p: optim.Quickprop(p, 0.05, literal=True)}
UNITS = [("logistic", "logistic"), ("tanh", "linear"), ("linear", "tanh"), ("relu", "linear")]
SIZES = (3, 7, 4, 2)


def problem(*lead: int):
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(*lead, 9, 3, dtype=torch.float64, generator=generator)
    return x, torch.stack([x.mean(-1), x.prod(-1)], -1)


def start(rule, *, members=3, units=UNITS[0], batch_size=None, shuffle=None, shared=False, **settings) -> Training:
    seeds = 0 if members is None else range(members)
    net = MLP(SIZES, hidden=units[0], output=units[1], members=members, seeds=seeds)
    x, y = problem() if shared or members is None else problem(members)
    return Training(net, rule(net.parameters()), Batches(x, y, batch_size=batch_size, shuffle=shuffle), **settings)


def weights(training: Training) -> torch.Tensor:
    members = training.network.members or 1
    return torch.cat([p.detach().reshape(members, -1) for p in training.network.parameters()], 1)


@pytest.fixture
def ran(monkeypatch) -> list[int]:
    """Epochs of every call of the kernels."""
    calls, run = [], compiled.run

    def counted(training, most):
        calls.append(run(training, most))
        return calls[-1]

    monkeypatch.setattr(compiled, "run", counted)
    return calls


def assert_same(a, b, **tolerance):
    """Nested dictionaries and lists with tensors at their ends."""
    assert type(a) is type(b)
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key], **tolerance)
    elif isinstance(a, list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y, **tolerance)
    elif isinstance(a, torch.Tensor):
        torch.testing.assert_close(a, b, equal_nan=True, **tolerance)
    else:
        assert a == b


def parts(training):
    return [part.state_dict() for part in (training.network, training.optimizer, training.data)]


def follow(training, other):
    """Put one training where another stands, without its history."""
    for part, state in zip((training.network, training.optimizer, training.data), parts(other), strict=True):
        part.load_state_dict(copy.deepcopy(state))


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("units", UNITS, ids="-".join)
@pytest.mark.parametrize(("batch_size", "shuffle"), [(1, None), (4, [3, -1, 4]), (None, None)])
def test_every_epoch_ends_where_torch_ends(rule, units, batch_size, shuffle, ran):
    """From the state of the kernels; left alone, quickprop's quotients part any two roundings."""
    setting = dict(units=units, batch_size=batch_size, shuffle=shuffle)
    ours, torchs = start(rule, **setting), start(rule, **setting, engine="torch")
    for epoch in range(1, 1 + 200 // ours.data.steps):
        ours.run(epoch, record=[1, 200 // ours.data.steps])
        torchs.run(epoch, record=[])
        assert_same(parts(ours), parts(torchs), rtol=1e-12, atol=1e-12)
        follow(torchs, ours)
    assert sum(ran) == epoch
    assert ours.history.train[-1].mean() < ours.history.train[0].mean()


@pytest.mark.parametrize("rule", [RULES["plain backprop"], RULES["backprop"], RULES["delta-bar-delta"]])
@pytest.mark.parametrize("batch_size", [1, None])
def test_where_rounding_fades_two_hundred_steps_end_where_torch_ends(rule, batch_size):
    ours, torchs = start(rule, batch_size=batch_size), start(rule, batch_size=batch_size, engine="torch")
    for training in (ours, torchs):
        training.run(200 // training.data.steps)
    assert_same(ours.state_dict(), torchs.state_dict(), rtol=0.0, atol=1e-12)


def test_the_printed_equation_begins_as_in_torch(ran):
    rule = LITERAL["literal quickprop"]
    ours, torchs = start(rule), start(rule, engine="torch")
    for epoch in range(1, 5):
        ours.run(epoch)
        torchs.run(epoch)
        assert_same(ours.state_dict(), torchs.state_dict(), rtol=1e-9, atol=1e-9)
    assert sum(ran) == epoch


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("members", [None, 1, 3])
@pytest.mark.parametrize("shuffle", [None, 5])
def test_either_path_goes_on_where_the_other_stood(rule, members, shuffle):
    setting = dict(members=members, batch_size=2, shuffle=shuffle, shared=True)
    for first, second in (("auto", "torch"), ("torch", "auto")):
        begun = start(rule, **setting, engine=first)
        begun.run(3)
        whole = start(rule, **setting, engine="torch")
        whole.run(3)
        assert_same(begun.state_dict(), whole.state_dict(), rtol=0.0, atol=1e-12)
        resumed = start(rule, **setting, engine=second)
        resumed.load_state_dict(copy.deepcopy(begun.state_dict()))
        resumed.run(6)
        whole.run(6)
        assert_same(resumed.state_dict(), whole.state_dict(), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("rule", {**RULES, **LITERAL}.values(), ids={**RULES, **LITERAL}.keys())
@pytest.mark.parametrize("batch_size", [1, 4])
def test_no_bit_depends_on_chunks_threads_or_neighbours(rule, batch_size, monkeypatch, ran):
    orders = [k % 5 - 1 for k in range(20)]

    def trained(members, seeds, shuffle, x, y):
        net = MLP(SIZES, hidden="logistic", members=members, seeds=seeds)
        data = Batches(x, y, batch_size=batch_size, shuffle=shuffle)
        training = Training(net, rule(net.parameters()), data)
        training.run(7, record=[7])
        return training

    x, y = problem(20)
    whole = trained(20, range(20), orders, x, y)
    assert ran == [7]
    monkeypatch.setattr(compiled, "_SECONDS_A_CHUNK", 0.0)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    again = trained(20, range(20), orders, x, y)
    assert ran == [7] + 7 * [1]
    assert_same(again.state_dict(), whole.state_dict(), rtol=0.0, atol=0.0)
    for k in (0, 7, 8, 19):
        alone = trained(None, k, None if orders[k] < 0 else orders[k], x[k], y[k])
        assert torch.equal(weights(alone)[0], weights(whole)[k])


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
@pytest.mark.parametrize("rule", {**RULES, **LITERAL}.values(), ids={**RULES, **LITERAL}.keys())
def test_a_lost_network_changes_no_bit_of_its_neighbours(rule, value):
    healthy, one_lost, torchs = start(rule), start(rule), start(rule, engine="torch")
    for training in (one_lost, torchs):
        with torch.no_grad():
            for parameter in training.network.parameters():
                parameter[1] = value
    for training in (healthy, one_lost, torchs):
        training.run(4)
    assert torch.equal(weights(healthy)[[0, 2]], weights(one_lost)[[0, 2]])
    assert torch.equal(weights(one_lost)[1].isfinite(), weights(torchs)[1].isfinite())
    assert torch.equal(one_lost.diverged_at, torchs.diverged_at)


def test_the_same_patterns_for_all_are_shown_in_one_order():
    shared = start(RULES["backprop"], batch_size=1, shuffle=3, shared=True)
    torchs = start(RULES["backprop"], batch_size=1, shuffle=3, shared=True, engine="torch")
    for training in (shared, torchs):
        training.run(5)
    assert_same(shared.state_dict(), torchs.state_dict(), rtol=0.0, atol=1e-13)


def test_a_rate_that_is_changed_between_epochs_counts(ran):
    for rule in RULES.values():
        ours, torchs = start(rule), start(rule, engine="torch")
        for training in (ours, torchs):
            training.run(2)
            training.optimizer.param_groups[0]["lr"] *= 0.5
            training.run(4)
        assert_same(ours.state_dict(), torchs.state_dict(), rtol=1e-12, atol=1e-12)
    assert sum(ran) == 4 * len(RULES)


def test_an_interrupt_leaves_everything_as_it_was(monkeypatch):
    from ikgrad.engine import perceptron

    training = start(RULES["quickprop"], batch_size=1, shuffle=[0, 1, 2])
    training.run(3)
    before = copy.deepcopy(training.state_dict())

    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(perceptron, "train", interrupted)
        with pytest.raises(KeyboardInterrupt):
            training.run(6)
    assert_same(training.state_dict(), before, rtol=0.0, atol=0.0)


def test_somebody_may_look_at_every_recorded_epoch_and_in_between(monkeypatch):
    seen = []
    training = start(RULES["backprop"])
    training.run(50, record=[10, 50], after_epoch=lambda t: seen.append(t.epoch))
    assert seen == [10, 50]
    assert training.history.epochs == [10, 50]
    monkeypatch.setattr(compiled, "_SECONDS_A_CHUNK", 0.0)
    training.run(60, record=[55, 70], after_epoch=lambda t: seen.append(t.epoch))
    assert seen == [10, 50, *range(51, 61)]
    assert training.history.epochs == [10, 50, 55]
    assert training.epoch == 60


def make(rule=RULES["backprop"], *, net=None, dtype=torch.float64, data=None, groups=None, **settings) -> Training:
    net = net or MLP(SIZES, dtype=dtype)
    data = data or Batches(*(part.to(dtype) for part in problem()))
    return Training(net, rule(groups(net) if groups else net.parameters()), data, **settings)


class Shifted(MLP):
    """Another network under the same parameters."""

    def layers(self, x):
        return super().layers(x + 1.0)


def hooked(parameters):
    optimizer = optim.Backprop(parameters, 0.05)
    optimizer.register_step_post_hook(lambda *args: None)
    return optimizer


def scheduled(parameters):
    optimizer = optim.Backprop(parameters, 0.05)
    torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.9)
    return optimizer


@pytest.mark.parametrize(
    "training",
    [
        lambda: make(engine="torch"),
        lambda: make(reduction="mean"),
        lambda: make(objective=lambda net, x, y: net(x) - y),
        lambda: make(dtype=torch.float32),
        lambda: make(net=MLP(SIZES, hidden="silu")),
        lambda: make(net=Shifted(SIZES)),
        lambda: make(net=torch.nn.Linear(3, 2, dtype=torch.float64)),
        lambda: make(torch.optim.SGD),
        lambda: make(hooked),
        lambda: make(scheduled),
        lambda: make(groups=lambda net: [{"params": net.weights}, {"params": net.biases}]),
        lambda: make(groups=lambda net: [*net.biases, *net.weights]),
        lambda: make(groups=lambda net: list(net.weights)),
        lambda: make(data=Batches(problem()[0], problem()[1][:, :1])),
    ],
)
def test_torch_does_what_the_kernels_cannot(training, ran):
    training = training()
    before = [p.detach().clone() for p in training.network.parameters()]
    training.run(2)
    assert not ran
    assert any(not torch.equal(a, b) for a, b in zip(before, training.network.parameters(), strict=True))


def test_data_for_more_networks_than_there_are_is_refused_as_by_torch(ran):
    with pytest.raises(RuntimeError, match="assign a gradient of size"):
        make(data=Batches(*problem(4))).run(1)
    assert not ran


def test_the_kernels_take_what_they_can(ran):
    for training in (make(), make(data=Batches(*problem(1)), net=MLP(SIZES, members=2, seeds=[0, 1]))):
        training.run(2)
    assert ran == [1, 1, 1, 1]
