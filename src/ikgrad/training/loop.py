"""The one training loop: any network, any optimizer, online or in batches, one network or many stacked."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Collection
from typing import Any, Literal

import torch
from torch import Tensor, nn

from ikgrad.errors import TrainingError
from ikgrad.networks import MLP
from ikgrad.training import compiled
from ikgrad.training.batches import Batches
from ikgrad.training.history import History

Objective = Callable[[nn.Module, Tensor, Tensor], Tensor]


def difference(network: nn.Module, x: Tensor, y: Tensor) -> Tensor:
    """The plain objective: what the network answers less what it should."""
    return network(x) - y


class Training:
    r"""A network, its data and its optimizer, and how far they have come.

    An epoch shows all patterns once; every batch of them is one step of the optimizer. The loss of a step is
    ``1/2 sum r^2`` over its patterns and outputs (``reduction="sum"``, the classical one) or the mean of ``r^2``, with
    r from ``objective``. Losses of stacked networks are added up, so that each learns as if it were alone.

    The best weights so far, by validation error or else by training error, are kept for every network by itself;
    `restore_best` puts them back.

    An `MLP` with one of the classical rules of `ikgrad.optim`, the plain objective and data in float64 on the CPU
    trains on compiled kernels, many epochs at a time: the same numbers but for rounding, a hundred times faster.

    Args:
        network: a module; an `MLP` with members is S networks.
        optimizer: any of torch's or ours, over the network's parameters. One with an attribute ``wants_residuals``
            gets a closure that returns r itself.
        data: the patterns to learn from.
        objective: (network, x, y) -> r, (..., B, m).
        reduction: how r becomes a loss.
        validation: patterns to judge by.
        patience: stop a network after so many recorded epochs in a row without a new best; None: never.
        engine: "torch" does without compiled kernels.

    Example:
        >>> from ikgrad import optim
        >>> x = torch.linspace(-1, 1, 20, dtype=torch.float64)[:, None]
        >>> net = MLP((1, 5, 1), members=3, seeds=range(3))
        >>> training = Training(net, optim.Backprop(net.parameters(), 0.02), Batches(x, x.sin()))
        >>> training.run(200, record=[1, 200])
        >>> before, after = training.history.train_table()
        >>> bool((after < before).all())
        True
    """

    def __init__(
        self,
        network: nn.Module,
        optimizer: torch.optim.Optimizer,
        data: Batches,
        *,
        objective: Objective = difference,
        reduction: Literal["sum", "mean"] = "sum",
        validation: Batches | None = None,
        patience: int | None = None,
        engine: Literal["auto", "torch"] = "auto",
    ):
        self.network, self.optimizer, self.data = network, optimizer, data
        self.objective, self.reduction = objective, reduction
        self.validation, self.patience, self.engine = validation, patience, engine
        self.history = History()
        self.epoch = 0
        members = getattr(network, "members", None)
        self._stacked = members is not None
        self.best_loss = torch.full((members or 1,), torch.inf, dtype=torch.float64)
        self.best_epoch = torch.zeros(members or 1, dtype=torch.int64)
        self.diverged_at = torch.zeros(members or 1, dtype=torch.int64)  # epoch; 0: it has not
        self.stopped = torch.zeros(members or 1, dtype=torch.bool)
        self._lost_step = 0  # the first whose loss was not finite, for some network
        self._failures = torch.zeros(members or 1, dtype=torch.int64)
        self._best = [parameter.detach().clone() for parameter in network.parameters()]
        self._step = self._choose_step()

    def run(
        self,
        epochs: int,
        *,
        record: Collection[int] | None = None,
        after_epoch: Callable[[Training], object] | None = None,
    ) -> None:
        """Train on until ``epochs`` epochs are done in all, or every network has stopped.

        Args:
            epochs: in all, those before included.
            record: epochs at which errors are taken, best weights kept and stopping is judged; default: all.
            after_epoch: called from time to time after an epoch, for progress and checkpoints: after every recorded
                one, and at least every few tenths of a second or after every epoch, whichever is longer.

        Raises:
            TrainingError: the loss of every network is infinite or not a number; the best weights are back then.
        """
        due = range(epochs + 1) if record is None else sorted({*record, epochs + 1})
        while self.epoch < epochs and not self.stopped.all():
            next_due = due[bisect_right(due, self.epoch)]
            self._advance(min(next_due, epochs))
            if self.epoch == next_due:
                self._record()
            if after_epoch is not None:
                after_epoch(self)

    def _advance(self, until: int) -> None:
        """Train for at least one epoch, and none beyond ``until``."""
        if self.engine == "auto" and self._is_plain() and compiled.serves(self):
            self.epoch += compiled.run(self, until - self.epoch)
            return
        for k, (x, y) in enumerate(self.data.epoch()):
            try:
                loss = self._step(x, y)
            except TrainingError as error:  # from the optimizer, which does not know how far we are
                raise self._lost(f"epoch {self.epoch + 1}: {error}") from error
            if loss is not None and not self._lost_step and not loss.isfinite().all():
                self._lost_step = self.epoch * self.data.steps + k + 1
        self.epoch += 1

    def mean_squared_error(self, data: Batches) -> Tensor:
        """(S,) mean squares of the objective over some data, S = 1 for a single network."""
        with torch.no_grad():
            r = self.objective(self.network, data.x, data.y).double()
            return (r.square().mean((-2, -1)) if self._stacked else r.square().mean()[None]).cpu()

    def restore_best(self) -> None:
        """Put the best weights of every network back."""
        with torch.no_grad():
            for parameter, best in zip(self.network.parameters(), self._best, strict=True):
                parameter.copy_(best)

    def state_dict(self) -> dict[str, Any]:
        """Everything that a training needs to go on as if it had never stopped."""
        progress = ("epoch", "best_loss", "best_epoch", "diverged_at", "stopped", "_failures", "_best", "_lost_step")
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "data": self.data.state_dict(),
            "history": vars(self.history),
            "progress": {name: getattr(self, name) for name in progress},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where another training of the same make stood."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.data.load_state_dict(state["data"])
        self.history = History(**state["history"])
        vars(self).update(state["progress"])

    def _choose_step(self) -> Callable[[Tensor, Tensor], Tensor | None]:
        if getattr(self.optimizer, "wants_residuals", False):
            return self._residual_step
        if (
            self._is_plain()
            and isinstance(self.network, MLP)
            and self.network.knows_its_gradient
            and self._one_gradient_a_step()
        ):
            return self._backpropagated_step
        return self._autograd_step

    def _is_plain(self) -> bool:
        return self.objective is difference and self.reduction == "sum"

    def _one_gradient_a_step(self) -> bool:
        """Whether the optimizer can do without a closure; L-BFGS searches along a line and cannot."""
        return not isinstance(self.optimizer, torch.optim.LBFGS)

    def _backpropagated_step(self, x: Tensor, y: Tensor) -> None:
        self.network.backpropagate(x, y)  # type: ignore[operator]
        self.optimizer.step()

    def _autograd_step(self, x: Tensor, y: Tensor) -> Tensor | None:
        def closure() -> Tensor:
            self.optimizer.zero_grad()
            loss = self._loss(self.objective(self.network, x, y))
            loss.backward()
            return loss

        loss: Tensor | None = self.optimizer.step(closure)  # type: ignore[arg-type, assignment]
        return loss

    def _residual_step(self, x: Tensor, y: Tensor) -> Tensor:
        return self.optimizer.step(lambda: self.objective(self.network, x, y))  # type: ignore[arg-type, return-value]

    def _loss(self, r: Tensor) -> Tensor:
        if self.reduction == "sum":
            return 0.5 * r.square().sum()
        return r.square().mean((-2, -1)).sum() if self._stacked else r.square().mean()

    def _record(self) -> None:
        train = self.mean_squared_error(self.data)
        judged = validation = self.mean_squared_error(self.validation) if self.validation else None
        judged = train if judged is None else judged
        self.history.add(self.epoch, train, validation)
        better = (judged < self.best_loss) & ~self.stopped
        self._keep(better)
        self.best_loss = torch.where(better, judged, self.best_loss)
        self.best_epoch[better] = self.epoch
        self._failures = torch.where(better, 0, self._failures + 1)
        if self.patience is not None:
            self.stopped |= self._failures >= self.patience
        self._watch_for_divergence(train)

    @torch.no_grad()
    def _keep(self, better: Tensor) -> None:
        for best, parameter in zip(self._best, self.network.parameters(), strict=True):
            if self._stacked:
                best[better] = parameter[better]
            elif better.item():
                best.copy_(parameter)

    def _watch_for_divergence(self, train: Tensor) -> None:
        lost = ~train.isfinite()
        self.diverged_at[lost & (self.diverged_at == 0)] = self.epoch
        if lost.all():
            step = self._lost_step or self.epoch * self.data.steps
            what = f"the loss is not finite after epoch {self.epoch}, step {step}"
            raise self._lost(what, ". Try a smaller learning rate")

    def _lost(self, what: str, advice: str = "") -> TrainingError:
        """The best weights are back; say of which epochs they are."""
        self.restore_best()
        kept = self.best_epoch.item() if len(self.best_epoch) == 1 else self.best_epoch.tolist()
        return TrainingError(f"{what}; the weights are those of epoch {kept}{advice}")


__all__ = ["Objective", "Training", "difference"]
