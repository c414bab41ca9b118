"""Training of inverters: one, or several of the same make side by side, each on data of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from ikgrad.data import DataSet, Samples
from ikgrad.errors import ShapeError
from ikgrad.networks import MLP, Inverter
from ikgrad.optim import LevenbergMarquardt
from ikgrad.training.batches import Batches
from ikgrad.training.loop import Training
from ikgrad.training.losses import Loss, joint
from ikgrad.training.optimizers import MakeOptimizer


def levenberg_marquardt(parameters: Sequence[nn.Parameter], members: int) -> torch.optim.Optimizer:
    """The optimizer of the stock settings."""
    return LevenbergMarquardt(parameters, members=members)


class InverterTraining:
    r"""Inverters that learn side by side; every one takes its scaling from its own training data.

    The networks are stacked, see `MLP`, and trained on scaled features. Residuals, and so the mean squared errors in
    the history, are in the units of ``loss``: joint units, rad^2 for an arm with turning joints. Validation rows decide
    on the best weights and, with ``patience``, on the end. The inverters have the trained weights after `finish`.

    Args:
        inverters: of the same sizes and activations; their first weights are where the training starts.
        data: one data set each, with the same numbers of rows.
        loss: what to make small, see `ikgrad.training.losses`.
        optimizer: (parameters, S) -> optimizer; default: Levenberg-Marquardt with members.
        batch_size: rows a step; None: all, which Levenberg-Marquardt needs.
        shuffle: seeds of new orders every epoch, one each; None: fixed order.
        patience: stop a network after so many epochs in a row without a new best on the validation rows.

    Raises:
        ShapeError: other than one data set each, or inverters or data that cannot be stacked.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("denso_vp6242")
        >>> sets = [ik.data.generate(robot, ik.data.SmoothPath(count=300, seed=seed)) for seed in (0, 1)]
        >>> inverters = [ik.Inverter(robot, seed=seed) for seed in (0, 1)]
        >>> training = InverterTraining(inverters, sets)
        >>> training.run(10)
        >>> training.finish()
        >>> bool((training.test_errors() < 1e-2).all())
        True
    """

    def __init__(
        self,
        inverters: Sequence[Inverter],
        data: Sequence[DataSet],
        *,
        loss: Loss = joint,
        optimizer: MakeOptimizer = levenberg_marquardt,
        batch_size: int | None = None,
        shuffle: Sequence[int] | None = None,
        patience: int | None = None,
    ):
        if not inverters or len(inverters) != len(data):
            raise ShapeError(f"every inverter needs a data set, got {len(inverters)} and {len(data)}")
        self.inverters, self.data = list(inverters), list(data)
        for inverter, dataset in zip(inverters, data, strict=True):
            inverter.fit(*arguments(inverter, dataset.train))
        self.stack = _stack([inverter.network for inverter in inverters])
        train = self._batches([d.train for d in data], batch_size=batch_size, shuffle=shuffle)
        has_validation = all(len(d.validation.q) for d in data)
        self.training = Training(
            self.stack,
            optimizer(list(self.stack.parameters()), len(inverters)),
            train,
            objective=loss(self.inverters),
            reduction="mean",
            validation=self._batches([d.validation for d in data]) if has_validation else None,
            patience=patience,
        )

    def run(self, epochs: int, *, after_epoch: Callable[[Training], object] | None = None) -> None:
        """Train on until ``epochs`` epochs are done in all, or every network has stopped, see `Training.run`."""
        self.training.run(epochs, after_epoch=after_epoch)

    def finish(self, *, best: bool = False) -> None:
        """Hand the weights to the inverters.

        Args:
            best: those with the smallest error on the validation rows, instead of the last.
        """
        if best:
            self.training.restore_best()
        for k, inverter in enumerate(self.inverters):
            inverter.network.load_state_dict(self.stack.member(k).state_dict())

    def test_errors(self) -> Tensor:
        """(S,) mean squared error of the inverters' joints over their test rows [rad^2 or m^2]."""
        return torch.stack([mean_squared_error(*pair) for pair in zip(self.inverters, self.test_rows, strict=True)])

    @property
    def test_rows(self) -> list[Samples]:
        """Test rows of every data set."""
        return [d.test for d in self.data]

    def _batches(
        self, parts: Sequence[Samples], *, batch_size: int | None = None, shuffle: Sequence[int] | None = None
    ) -> Batches:
        if len({len(part.q) for part in parts}) > 1:
            raise ShapeError(f"data sets side by side need the same numbers of rows, got {[len(p.q) for p in parts]}")
        x, y = zip(*(patterns(i, part) for i, part in zip(self.inverters, parts, strict=True)), strict=True)
        return Batches(torch.stack(x), torch.stack(y), batch_size=batch_size, shuffle=shuffle)


def arguments(inverter: Inverter, rows: Samples) -> tuple[Tensor, Tensor, Tensor | None]:
    """T, q and, for a feedback inverter, the present joints, in the inverter's dtype and on its device."""
    T, q, q_current = (part.to(inverter.reference) for part in rows)
    return T, q, q_current if inverter.feedback else None


@torch.no_grad()
def patterns(inverter: Inverter, rows: Samples) -> tuple[Tensor, Tensor]:
    """(N, k) and (N, n): scaled inputs and targets of the inverter's network."""
    T, q, q_current = arguments(inverter, rows)
    return inverter.input_scale(inverter.features(T, q_current)), inverter.output_scale(q)


@torch.no_grad()
def answers(inverter: Inverter, rows: Samples) -> Tensor:
    """(N, n) what the inverter says to the rows, given their true present joints."""
    T, _, q_current = arguments(inverter, rows)
    return inverter(T, q_current)


def mean_squared_error(inverter: Inverter, rows: Samples) -> Tensor:
    """Mean over rows and joints of ``(q - d)^2`` [rad^2 or m^2], present joints given."""
    return (answers(inverter, rows) - rows.q.to(inverter.reference)).square().mean()


def _stack(networks: Sequence[MLP]) -> MLP:
    """Networks of the same make as one with members, parameters copied."""
    makes = {(net.sizes, net.hidden, net.output) for net in networks}
    if len(makes) > 1:
        raise ShapeError(f"only networks of the same make can be stacked, got {sorted(map(str, makes))}")
    sizes, hidden, output = makes.pop()
    stack = MLP(
        sizes,
        hidden=hidden,
        output=output,
        members=len(networks),
        seeds=range(len(networks)),
        dtype=networks[0].weights[0].dtype,
    ).to(networks[0].weights[0].device)
    with torch.no_grad():
        for ours, *theirs in zip(stack.parameters(), *(net.parameters() for net in networks), strict=True):
            ours.copy_(torch.stack(list(theirs)))
    return stack


__all__ = ["InverterTraining", "answers", "arguments", "levenberg_marquardt", "mean_squared_error", "patterns"]
