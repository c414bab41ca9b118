"""One loop: order of the data, stacks, stopping, resuming, mistakes."""

from __future__ import annotations

import pytest
import torch

from ikgrad import optim
from ikgrad.errors import DataError, ShapeError, TrainingError
from ikgrad.networks import MLP
from ikgrad.training import Batches, Training, load_checkpoint, log_epochs, save_checkpoint

RULES = {
    "backprop": lambda p: optim.Backprop(p, 0.05, momentum=0.5),
    "delta-bar-delta": lambda p: optim.DeltaBarDelta(p, 0.05, momentum=0.5),
    "quickprop": lambda p: optim.Quickprop(p, 0.05),
    "adam": lambda p: torch.optim.Adam(p, 0.01),
    "rprop": lambda p: torch.optim.Rprop(p, 0.01),
}


def problem(*, members: int | None = None, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    lead = () if members is None else (members,)
    x = torch.rand(*lead, 9, 3, dtype=torch.float64, generator=generator)
    return x, torch.stack([x.mean(-1), x.prod(-1)], -1)


def start(rule, *, members=None, seeds=0, batch_size=None, shuffle=None, hidden="logistic", **settings) -> Training:
    net = MLP((3, 6, 2), hidden=hidden, output="logistic", members=members, seeds=seeds)
    x, y = problem(members=members)
    return Training(net, rule(net.parameters()), Batches(x, y, batch_size=batch_size, shuffle=shuffle), **settings)


def weights(training: Training) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in training.network.parameters()])


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("batch_size", [1, 4, None])
def test_a_member_learns_as_it_would_alone(rule, batch_size):
    seeds = [3, 4, 5]
    stack = start(rule, members=3, seeds=seeds, batch_size=batch_size, shuffle=[7, -1, 8])
    stack.run(20)
    x, y = problem(members=3)
    for k, order in enumerate([7, None, 8]):
        net = MLP((3, 6, 2), hidden="logistic", output="logistic", seeds=seeds[k])
        alone = Training(net, rule(net.parameters()), Batches(x[k], y[k], batch_size=batch_size, shuffle=order))
        alone.run(20)
        for a, b in zip(stack.network.member(k).parameters(), net.parameters(), strict=True):
            torch.testing.assert_close(a, b, rtol=0.0, atol=1e-10)
        torch.testing.assert_close(stack.history.train_table()[:, k], alone.history.train_table()[:, 0])


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
def test_the_fast_gradient_changes_nothing(rule):
    fast = start(rule, batch_size=1)
    slow = start(rule, batch_size=1, objective=lambda net, x, y: net(x) - y)
    fast.run(30)
    slow.run(30)
    assert fast._step.__name__ == "_backpropagated_step"
    assert slow._step.__name__ == "_autograd_step"
    torch.testing.assert_close(weights(fast), weights(slow), rtol=0.0, atol=1e-10)


def test_every_pattern_is_shown_once_an_epoch_in_orders_that_change():
    x = torch.arange(10.0)[:, None]
    data = Batches(x, x, batch_size=3, shuffle=0)
    orders = [torch.cat([part for part, _ in data.epoch()]).flatten() for _ in range(5)]
    assert all(torch.equal(order.sort().values, x.flatten()) for order in orders)
    assert len({tuple(order.tolist()) for order in orders}) == 5
    assert data.steps == 4


@pytest.mark.parametrize("count", [1, 9, 100])
def test_orders_do_not_depend_on_how_epochs_are_split(count):
    def data():
        x = torch.zeros(2, count, 1)
        return Batches(x, x, batch_size=1, shuffle=[3, -1])

    whole, parts = data(), data()
    expected = whole.orders(7)
    assert torch.equal(torch.cat([parts.orders(epochs) for epochs in (1, 4, 2)]), expected)
    assert expected.shape == (7, 2, count)
    assert torch.equal(expected[:, 1], torch.arange(count).expand(7, -1))
    assert torch.equal(expected.sort(-1).values, torch.arange(count).expand(7, 2, -1))


def test_all_orders_of_three_patterns_are_equally_likely():
    x = torch.zeros(3, 1)
    orders = Batches(x, x, batch_size=1, shuffle=0).orders(6000)[:, 0]
    _, counts = orders.unique(dim=0, return_counts=True)
    assert len(counts) == 6
    assert ((counts - 1000).abs() < 150).all()  # five standard deviations


def test_a_fixed_order_is_the_order_of_the_data():
    x = torch.arange(5.0)[:, None]
    for _ in range(2):
        data = Batches(x, -x, batch_size=2)
        assert torch.equal(torch.cat([part for part, _ in data.epoch()]), x)
        assert torch.equal(torch.cat([part for _, part in data.epoch()]), -x)


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("shuffle", [None, [0, 1]])
def test_resuming_from_a_file_changes_no_bit(rule, shuffle, tmp_path):
    def fresh():
        return start(rule, members=2, seeds=[0, 1], batch_size=2, shuffle=shuffle)

    whole = fresh()
    whole.run(40)
    half = fresh()
    half.run(17)
    save_checkpoint(tmp_path / "c.ckpt", half.state_dict())
    resumed = fresh()
    resumed.load_state_dict(load_checkpoint(tmp_path / "c.ckpt"))
    assert resumed.epoch == 17
    resumed.run(40)
    assert torch.equal(weights(resumed), weights(whole))
    assert resumed.history.epochs == whole.history.epochs
    assert torch.equal(resumed.history.train_table(), whole.history.train_table())
    assert torch.equal(resumed.best_loss, whole.best_loss)


def test_lbfgs_gets_a_closure():
    training = start(lambda p: torch.optim.LBFGS(p, max_iter=5, line_search_fn="strong_wolfe"), reduction="mean")
    training.run(20)
    first, last = training.history.train_table()[[0, -1], 0]
    assert last < 0.1 * first


def test_the_best_weights_come_back():
    training = start(lambda p: optim.Backprop(p, 30.0, momentum=0.9), members=3, seeds=range(3))  # it jumps about
    training.run(60)
    table = training.history.train_table()
    assert torch.equal(training.best_loss, table.amin(0))
    assert (training.best_epoch == table.argmin(0) + 1).all()
    training.restore_best()
    assert torch.equal(training.mean_squared_error(training.data), training.best_loss)


def test_validation_stops_each_network_by_itself():
    x, y = problem(members=2)
    net = MLP((3, 6, 2), members=2, seeds=[0, 1])
    far = Batches(x + 5.0, y)  # learning makes it worse there sooner or later
    training = Training(net, optim.Backprop(net.parameters(), 0.02), Batches(x, y), validation=far, patience=6)
    training.run(5000)
    assert training.stopped.all()
    table = training.history.validation_table()
    for k in range(2):
        best = int(training.best_epoch[k])
        assert table[best - 1, k] == training.best_loss[k]
        assert (table[best : best + 6, k] >= training.best_loss[k]).all()
    assert training.epoch == int(training.best_epoch.max()) + 6
    assert training.epoch < 5000


def test_one_diverging_network_leaves_the_others_alone():
    x, y = problem(members=2)
    net = MLP((3, 6, 2), members=2, seeds=[0, 1])
    with torch.no_grad():
        for parameter in net.parameters():
            parameter[0] *= torch.nan
    training = Training(net, optim.Backprop(net.parameters(), 0.05), Batches(x, y))
    training.run(5)
    assert training.diverged_at.tolist() == [1, 0]
    assert training.history.train_table()[:, 1].isfinite().all()


def test_a_network_that_diverges_says_when_and_keeps_its_best():
    training = start(lambda p: optim.Backprop(p, 1e200), hidden="linear")
    training.network.output = "linear"
    with pytest.raises(
        TrainingError, match=r"not finite after epoch \d+, step \d+; the weights are those of epoch \d+"
    ):
        training.run(50)
    assert weights(training).isfinite().all()


def test_epochs_of_a_logarithmic_curve():
    epochs = log_epochs(1_000_000)
    assert epochs[0] == 1
    assert epochs[-1] == 1_000_000
    assert epochs == sorted(set(epochs))
    assert 80 < len(epochs) < 130
    assert log_epochs(1) == [1]


X = torch.zeros(4, 2)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: Batches(X, torch.zeros(3, 1)), ShapeError, r"same N, got \(4, 2\), \(3, 1\)"),
        (lambda: Batches(X[:0], X[:0]), DataError, "the data set is empty"),
        (
            lambda: Batches(X, X.index_fill(0, torch.tensor(2), torch.inf)),
            DataError,
            r"y\[2, 0\] is inf; the data must",
        ),
        (lambda: Batches(X, X, batch_size=0), ValueError, "batch_size must be at least 1, got 0"),
        (lambda: Batches(X, X, shuffle=[0, 1]), ShapeError, r"2 seeds for data of shape \(4, 2\)"),
    ],
)
def test_mistakes_are_named(call, error, text):
    with pytest.raises(error, match=text):
        call()


def damaged(path, change):
    content = bytearray(path.read_bytes())
    path.write_bytes(change(content))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda content: content[:-100], "truncated or was changed"),
        (lambda content: content[:30], "truncated or was changed"),
        (lambda content: content[:-1] + bytes([content[-1] ^ 1]), "truncated or was changed"),
        (lambda content: b"PK" + content, "is not a checkpoint of this version"),
        (lambda content: b"", "is not a checkpoint of this version"),
    ],
)
def test_a_damaged_checkpoint_is_refused(tmp_path, change, text):
    path = tmp_path / "c.ckpt"
    save_checkpoint(path, {"a": torch.ones(100)})
    damaged(path, change)
    with pytest.raises(DataError, match=text):
        load_checkpoint(path)


def test_a_checkpoint_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "c.ckpt"
    save_checkpoint(path, {"a": torch.ones(1)})

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(DataError, match="cannot write the checkpoint: No space left on device"):
        save_checkpoint(path, {"a": torch.zeros(1)})
    assert load_checkpoint(path)["a"].item() == 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["c.ckpt"]


def test_no_checkpoint_no_resume(tmp_path):
    with pytest.raises(DataError, match="cannot read the checkpoint: No such file"):
        load_checkpoint(tmp_path / "none.ckpt")
