"""A training run: all its networks, and the run folder that they are kept in."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import torch

from ikgrad import __version__
from ikgrad.config import TrainConfig
from ikgrad.data import DataSet
from ikgrad.errors import TrainingError
from ikgrad.networks import Inverter, load_inverter
from ikgrad.robot import Robot, load_robot
from ikgrad.training.events import Events, Point, require_tensorboard
from ikgrad.training.inverters import InverterTraining
from ikgrad.training.loop import Training
from ikgrad.training.losses import LOSSES
from ikgrad.training.measure import measure
from ikgrad.training.memory import available_memory, check_memory
from ikgrad.training.optimizers import make_optimizer, side_by_side
from ikgrad.training.report import check_device, describe_run
from ikgrad.training.result import (
    Curve,
    Member,
    TrainResult,
    curve_points,
    curves_from_csv,
    curves_of,
    curves_to_csv,
    member_from_json,
    member_to_json,
)
from ikgrad.training.run_folder import FINISHED, RunFolder
from ikgrad.training.sources import load_data, planned_rows
from ikgrad.training.threads import one_thread

_SMALL, _SMALL_SQUARE = 100_000, 1000  # weights; below, one thread is faster than several, or as fast (J^T J)


@dataclass(frozen=True)
class TrainProgress:
    """Where a training stands.

    Attributes:
        done: epochs done; networks that are trained one after another add up.
        total: epochs at most.
        train: mean squared error on the training rows, mean over the networks side by side, in the units of the loss.
        validation: the same on the validation rows; None without any.
    """

    done: int
    total: int
    train: float
    validation: float | None


class Run:
    """All networks of a run, side by side where the optimizer allows, else one after another."""

    def __init__(
        self,
        config: TrainConfig,
        robot: Robot | None,
        data: DataSet | None,
        progress: Callable[[TrainProgress], object] | None,
    ):
        self.config, self.progress = config, progress
        self.robot = load_robot(config.robot, base=config.base, tip=config.tip) if robot is None else robot
        if config.tensorboard:
            require_tensorboard()
        make = make_optimizer(config.optimizer, lr=config.lr, options=config.optimizer_options)
        check_device(config.device)
        together = config.members if side_by_side(config.optimizer) else 1
        self._check_memory(planned_rows(config) if data is None else len(data.samples.q), together)
        sets = load_data(config, self.robot) if data is None else [data] * config.members
        if data is None and isinstance(config.data, str):
            self._check_memory(len(sets[0].samples.q), together)
        inverters = [self._inverter(seed) for seed in config.seeds]
        shuffle = None if config.batch_size is None else list(config.seeds)
        self.trainings = [
            InverterTraining(
                inverters[k : k + together],
                sets[k : k + together],
                loss=LOSSES[config.loss],
                optimizer=make,
                batch_size=config.batch_size,
                shuffle=shuffle and shuffle[k : k + together],
                patience=config.patience,
            )
            for k in range(0, config.members, together)
        ]
        self.sets, self.inverters = sets, tuple(inverters)
        self.manifest = self._manifest()
        self.folder: RunFolder | None = None
        self.events: Events | None = None
        self._before = 0.0  # seconds of the parts that were cut off
        self._start = self._saved = time.perf_counter()

    def open(self, folder: RunFolder, *, resume: bool) -> bool:
        """Begin the run folder or go on with it; True if the run is finished already."""
        self.folder = folder
        state = folder.open(self.manifest, self.config, resume=resume)
        if state is not None:
            self._before = state["seconds"]
            for training, saved in zip(self.trainings, state["trainings"], strict=True):
                training.training.load_state_dict(saved)
        if self.config.tensorboard:
            self.events = Events(folder.events, self.config.seeds, self._points)
        return state is None and resume and folder.report()["state"] == FINISHED

    def complete(self, checkpoint_seconds: float) -> TrainResult:
        """Train to the end."""
        weights = sum(parameter.numel() for parameter in self.inverters[0].network.parameters())
        limit = _SMALL_SQUARE if self.config.optimizer == "levenberg_marquardt" else _SMALL
        small = self.config.device == "cpu" and weights < limit
        self._start = self._saved = time.perf_counter()
        with one_thread() if small else contextlib.nullcontext(), contextlib.ExitStack() as stack:
            if self.events is not None:
                stack.callback(self.events.close)
            return self._train(checkpoint_seconds)

    def _train(self, checkpoint_seconds: float) -> TrainResult:
        for k, training in enumerate(self.trainings):
            try:
                training.run(self.config.epochs, after_epoch=partial(self._look, k, checkpoint_seconds))
            except TrainingError as error:
                raise self._failed(error) from error
            training.finish(best=True)
        return self._finish(FINISHED)

    def finished(self, folder: RunFolder) -> TrainResult:
        """The result of a run that ended before."""
        report = folder.report()
        models = folder.models(self.config.members)
        inverters = cast(tuple[Inverter, ...], tuple(load_inverter(path, robot=self.robot) for path in models))
        members = tuple(member_from_json(values) for values in report["members"])
        curves = tuple(curves_from_csv(folder.history(), len(members)))
        return TrainResult(self.config, inverters, members, curves, report["seconds"], folder.path)

    @property
    def seconds(self) -> float:
        """Of training so far."""
        return self._before + time.perf_counter() - self._start

    def save(self) -> None:
        """Write a checkpoint; only between epochs."""
        self._saved = time.perf_counter()
        if self.folder is not None:
            if self.events is not None:
                self.events.write()  # first, so that what a checkpoint holds is always there
            states = [training.training.state_dict() for training in self.trainings]
            state = {"manifest": self.manifest, "seconds": self.seconds, "trainings": states}
            self.folder.save_state(state, curves_to_csv(self._curves()))

    def _look(self, k: int, checkpoint_seconds: float, training: Training) -> None:
        """After an epoch: tell, and keep."""
        try:
            if self.progress is not None:
                self.progress(self._progress(training, k))
        except KeyboardInterrupt:
            self.save()
            raise
        if time.perf_counter() - self._saved >= checkpoint_seconds:
            self.save()

    def _progress(self, training: Training, k: int) -> TrainProgress:
        history, epochs = training.history, self.config.epochs
        validation = history.validation[-1].mean().item() if history.validation else None
        total = epochs * len(self.trainings)
        return TrainProgress(k * epochs + training.epoch, total, history.train[-1].mean().item(), validation)

    def _failed(self, error: TrainingError) -> TrainingError:
        """Keep the last good weights, and say where they are."""
        for training in self.trainings:
            training.finish(best=True)
        if self.folder is None:
            return error
        self._finish(f"failed: {error}")
        return TrainingError(f"{error}; kept in {', '.join(map(str, self.folder.models(self.config.members)))}")

    def _finish(self, state: str) -> TrainResult:
        seconds, members, curves = self.seconds, self._members(), self._curves()
        if self.folder is not None:
            if self.events is not None:
                self.events.write()
            weights = dict(zip(self.folder.models(self.config.members), self.inverters, strict=True))
            self.folder.finish(self._report(state, seconds, members), weights, curves_to_csv(curves))
        path = None if self.folder is None else self.folder.path
        return TrainResult(self.config, self.inverters, tuple(members), tuple(curves), seconds, path)

    def _members(self) -> list[Member]:
        members: list[Member] = []
        for training in self.trainings:
            loop = training.training
            for k, inverter in enumerate(training.inverters):
                test = measure(inverter, training.data[k].test)
                numbers = (loop.epoch, int(loop.best_epoch[k]), float(loop.best_loss[k]), int(loop.diverged_at[k]))
                members.append(Member(self.config.seed + len(members), *numbers, test))
        return members

    def _points(self, k: int, start: int) -> list[Point]:
        return curve_points(self._curves()[k], start)

    def _curves(self) -> list[Curve]:
        return [c for t in self.trainings for c in curves_of(t.training.history, len(t.inverters))]

    def _report(self, state: str, seconds: float, members: Sequence[Member]) -> dict[str, Any]:
        data = self.sets[0]
        rows = {part: len(getattr(data, part).q) for part in ("train", "validation", "test")}
        return {
            **describe_run(self.config, self.robot, state, seconds, self.manifest),
            "rows": rows,
            "members": [member_to_json(member) for member in members],
        }

    def _manifest(self) -> dict[str, Any]:
        digest = hashlib.sha256()
        for data in dict.fromkeys(self.sets):
            for rows in (*data.samples, data.part):
                digest.update(rows.cpu().numpy().tobytes())
        return {
            **vars(self.config),
            "robot fingerprint": self.robot.fingerprint,
            "content of the data": digest.hexdigest()[:32],
            "ikgrad version": __version__,
            "torch version": str(torch.__version__),
        }

    def _inverter(self, seed: int) -> Inverter:
        config = self.config
        inverter = Inverter(
            self.robot,
            feedback=config.feedback,
            hidden=config.hidden,
            activation=config.activation,
            encoding=config.encoding,
            bounded=config.bounded,
            seed=seed,
            dtype=getattr(torch, config.dtype),
        )
        return inverter.to(config.device)

    def _check_memory(self, rows: int, together: int) -> None:
        config = self.config
        probe = Inverter(self.robot, feedback=config.feedback, hidden=(1,), encoding=config.encoding)
        check_memory(
            (len(probe.feature_names), *config.hidden, self.robot.dof),
            rows=rows,
            batch_size=config.batch_size,
            members=together,
            item=getattr(torch, config.dtype).itemsize,
            optimizer=config.optimizer,
            available=available_memory(config.device),
        )


__all__ = ["Run", "TrainProgress"]
