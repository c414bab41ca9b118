"""Training on a stream without end, within a budget of minutes or of steps."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ikgrad.data import TaskStream
from ikgrad.data.schemes import Samples
from ikgrad.errors import ConfigError, RobotError, TrainingError
from ikgrad.networks.local import IncrementInverter, UnrolledInverter
from ikgrad.solvers.damped import damped_steps, typical_length
from ikgrad.training.pose_loss import PoseLoss
from ikgrad.training.processes import Processes

_WARM_UP = 0.02  # of the budget
_CHECKED_ROWS = 4000
# Rows whose gradient is taken at once on the CPU. Two processes take the pieces that one would take, and the sum is in
# float64, so that they learn the same to the last bit. Without that Muon, whose products are in bfloat16, makes 5e-4 of
# a rounding error within 50 steps. Costs a seventh of a step.
_PIECE = 512
_LONGEST_PAUSE = 20.0  # seconds between checks at most, with a budget of time: a curve on the terminal shall live
LOSSES = {IncrementInverter: PoseLoss(shape="root", delta=0.02), UnrolledInverter: PoseLoss(shape="log", delta=0.001)}


@dataclass(frozen=True)
class Check:
    """A point of the curve: how good the inverter is on rows that it never learns from.

    Attributes:
        step: optimizer steps done.
        seconds: of training so far.
        loss: of the last round on the validation rows; the lowest decides which weights are kept.
        position_mm: median and 95th percentile [mm].
        rotation_deg: median and 95th percentile [deg].
    """

    step: int
    seconds: float
    loss: float
    position_mm: tuple[float, float]
    rotation_deg: tuple[float, float]


class EndlessTraining:
    """An inverter that learns from a stream until the budget is spent; every batch is new.

    The learning rate rises over the first 2 % of the budget and then falls to zero along a cosine, whatever the budget
    is. Square matrices learn by Muon, everything else by AdamW. With a budget of steps the result depends on the seeds
    alone; with one of minutes also on the machine.

    Args:
        inverter: what learns.
        stream: where the rows come from.
        minutes: budget of training time; give this or ``steps``.
        steps: budget of optimizer steps.
        loss: of every round; default: by the inverter's family, see `LOSSES`.
        lr: largest learning rate.
        validation: rows for the curve; default: 4,000 of the same task and another seed.
        checks: points of the curve, evenly spaced over the budget; with ``minutes`` at least one every 20 s.
        processes: others that share the training; the batches are the same, and so is the result, to rounding.

    The inverter may be on a GPU; the rows are made on the CPU always.

    Raises:
        ConfigError: no budget or two, or a setting that is not positive.
        RobotError: inverter and stream belong to different robots.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> inverter = UnrolledInverter(robot, rounds=2, width=32)
        >>> training = EndlessTraining(inverter, TaskStream(robot, batch_size=256), steps=40)
        >>> training.run()
        >>> training.history[-1].position_mm[0] < training.history[0].position_mm[0]
        True
    """

    def __init__(
        self,
        inverter: IncrementInverter,
        stream: TaskStream,
        *,
        minutes: float | None = None,
        steps: int | None = None,
        loss: PoseLoss | None = None,
        lr: float = 0.016,
        validation: TaskStream | None = None,
        checks: int = 40,
        processes: Processes = Processes(),  # noqa: B008 (frozen)
    ):
        _check(inverter, stream, minutes, steps, lr, checks)
        self.inverter, self.stream, self.minutes, self.steps = inverter, stream, minutes, steps
        self.loss = LOSSES[type(inverter)] if loss is None else loss
        self.lr, self.checks, self.processes = lr, checks, processes
        self.rows = processes.rows(stream.batch_size)
        self._sizes = [1, *(parameter.numel() for parameter in inverter.parameters())]
        self.device = next(inverter.parameters()).device
        other = replace(stream, batch_size=_CHECKED_ROWS, seed=(stream.seed + 2**30) % 2**31, label="made")
        self.validation = self._here((other if validation is None else validation).batch(0))
        self.optimizers = _optimizers(inverter, lr)
        self.step, self.seconds, self.train_loss = 0, 0.0, math.nan
        self.history: list[Check] = []
        self.best_loss = math.inf
        self._best = self._weights()

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, 0 to 1."""
        if self.steps is not None:
            return min(1.0, self.step / self.steps)
        assert self.minutes is not None
        return min(1.0, self.seconds / (60.0 * self.minutes))

    def run(self, *, until: float = 1.0, watch: Callable[[EndlessTraining], object] | None = None) -> None:
        """Train on until a share of the budget is spent; at the end of it the best weights are put in place.

        Args:
            until: share of the budget at which to stop; a checkpoint taken there goes on as if nothing had been.
            watch: called after every step, and once before the first, for progress and checkpoints; its time does not
                count. An exception of it ends the training between two steps.

        Raises:
            TrainingError: the loss is not finite; the best weights are back then.
        """
        if not self.history:
            self._judge()
            if watch is not None:
                watch(self)
        while self.progress < until:
            due = math.floor(self.progress * self.checks)
            begun = time.perf_counter()
            self._learn()
            self.seconds += self.processes.from_first(time.perf_counter() - begun)
            if math.floor(self.progress * self.checks) > due or self._curve_is_old():
                self._judge()
            if watch is not None:
                watch(self)
        if self.progress >= 1.0:
            self.restore_best()

    def restore_best(self) -> None:
        """Put the weights with the lowest validation loss back."""
        self._put(self._best)

    def state_dict(self) -> dict[str, Any]:
        """Everything that a training needs to go on; for `ikgrad.training.save_checkpoint`."""
        return {
            "weights": self._weights(),
            "best": dict(self._best),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "progress": {"step": self.step, "seconds": self.seconds, "best_loss": self.best_loss},
            "history": [asdict(check) for check in self.history],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where another training of the same make stood; the next batch is the one that it would have taken."""
        self._put(state["weights"])
        self._best = {name: value.clone() for name, value in state["best"].items()}
        for optimizer, saved in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(saved)
        vars(self).update(state["progress"])
        self.history = [Check(**check) for check in state["history"]]

    def _here(self, rows: Samples) -> Samples:
        return Samples(*(part.to(self.device) for part in rows))

    def _curve_is_old(self) -> bool:
        """Only where the result depends on the machine anyway: a check may change which weights are kept."""
        return self.steps is None and self.seconds - self.history[-1].seconds > _LONGEST_PAUSE

    def _learn(self) -> None:
        """One step of the optimizers."""
        rows = self.stream.batch(self.step, rows=self.rows)
        size = len(rows.q) if self.device.type != "cpu" else _PIECE
        pieces = [self._gradient(Samples(*piece)) for piece in zip(*(part.split(size) for part in rows), strict=True)]
        loss, *gradient = self.processes.add_up(torch.stack(pieces).sum(0)).split(self._sizes)
        self.train_loss = float(loss)
        self._refuse_unless_finite(self.train_loss, "in")
        rate = self.lr * min(1.0, (self.progress + 1e-4) / _WARM_UP) * 0.5 * (1.0 + math.cos(math.pi * self.progress))
        for parameter, part in zip(self.inverter.parameters(), gradient, strict=True):
            parameter.grad = part.view_as(parameter).to(parameter.dtype)
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = rate
            optimizer.step()
        self.step += 1

    def _gradient(self, rows: Samples) -> Tensor:
        """Loss of some rows and its gradient, end to end, in float64: their share of the batch's mean."""
        T, label, q_current = self._here(rows)
        total = torch.zeros((), dtype=torch.float64, device=self.device)
        for q in self.inverter.iterates(T, q_current):
            total = total + self.loss(self.inverter.robot, q, T, label)
        parts = torch.autograd.grad(total, list(self.inverter.parameters()))
        share = len(T) / self.stream.batch_size
        return share * torch.cat([total.detach()[None], *(part.flatten().double() for part in parts)])

    def _refuse_unless_finite(self, loss: float, when: str) -> None:
        if not math.isfinite(loss):
            self.restore_best()
            step = self.step + (when == "in")
            raise TrainingError(
                f"the loss is not finite {when} step {step}; the best weights are back. Try a smaller lr than "
                f"{self.lr:g}"
            )

    @torch.no_grad()
    def _judge(self) -> None:
        T, _, q_current = self.validation
        at = damped_steps(self.inverter.robot, T, self.inverter.iterates(T, q_current)[-1])
        loss = self.processes.from_first(float(self.loss.rho(at.error.square().sum(-1))[0].mean()))
        self._refuse_unless_finite(loss, "after")
        position, rotation = at.error[:, :3].norm(dim=-1), at.error[:, 3:].norm(dim=-1)
        mm = _median_and_95th(position * typical_length(self.inverter.robot) * 1e3)
        self.history.append(Check(self.step, self.seconds, loss, mm, _median_and_95th(rotation.rad2deg())))
        if loss < self.best_loss:
            self.best_loss, self._best = loss, self._weights()

    def _weights(self) -> dict[str, Tensor]:
        return {name: value.detach().clone() for name, value in self.inverter.state_dict().items()}

    def _put(self, weights: dict[str, Tensor]) -> None:
        self.inverter.load_state_dict(weights)


def _median_and_95th(values: Tensor) -> tuple[float, float]:
    median, most = values.quantile(torch.tensor([0.5, 0.95]).to(values)).tolist()
    return median, most


def _optimizers(inverter: IncrementInverter, lr: float) -> list[torch.optim.Optimizer]:
    """Muon for square matrices, its steps scaled to the size of AdamW's; AdamW for what is left."""
    inner = inverter.network.inner
    ours = {id(parameter) for parameter in inner}
    rest = [parameter for parameter in inverter.parameters() if id(parameter) not in ours]
    adamw: torch.optim.Optimizer = torch.optim.AdamW(rest, lr=lr, betas=(0.9, 0.99), weight_decay=0.0)
    if not inner:
        return [adamw]
    return [torch.optim.Muon(inner, lr=lr, weight_decay=0.0, adjust_lr_fn="match_rms_adamw", ns_steps=4), adamw]


def _check(
    inverter: IncrementInverter, stream: TaskStream, minutes: float | None, steps: int | None, lr: float, checks: int
) -> None:
    if (minutes is None) == (steps is None):
        raise ConfigError("give a budget: minutes or steps, one of them")
    for name, value in (("minutes", minutes), ("steps", steps), ("lr", lr), ("checks", checks)):
        if value is not None and not 0 < value < math.inf:
            raise ConfigError(f"{name} must be positive and finite, got {value}")
    if inverter.robot.fingerprint != stream.robot.fingerprint:
        raise RobotError(
            f"the inverter is for robot '{inverter.robot.name}' ({inverter.robot.fingerprint}), the stream for "
            f"'{stream.robot.name}' ({stream.robot.fingerprint})"
        )


__all__ = ["Check", "EndlessTraining", "LOSSES"]
