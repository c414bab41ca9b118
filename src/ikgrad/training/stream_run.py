"""A run of trainings on a stream: members one after the other, the run folder, and processes that share the work."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import torch

from ikgrad import __version__
from ikgrad.config import StreamConfig
from ikgrad.data import TaskStream
from ikgrad.errors import ConfigError, TrainingError
from ikgrad.networks import IncrementInverter, load_inverter
from ikgrad.networks.local import FAMILIES
from ikgrad.robot import Robot, load_robot
from ikgrad.training.endless import LOSSES, Check, EndlessTraining
from ikgrad.training.events import Events, Point, require_tensorboard
from ikgrad.training.memory import available_memory, check_stream_memory
from ikgrad.training.pose_loss import PoseLoss
from ikgrad.training.processes import Processes
from ikgrad.training.report import check_device, describe_run
from ikgrad.training.run_folder import FINISHED, RunFolder
from ikgrad.training.stream_result import (
    StreamMember,
    StreamResult,
    best_of,
    check_points,
    checks_from_csv,
    checks_to_csv,
)

_DELTAS = {"log": 0.001, "root": 0.02, "square": 0.02}


@dataclass(frozen=True)
class StreamProgress:
    """Where a training on a stream stands.

    Attributes:
        share: of the budget of all members that is spent, 0 to 1.
        steps: of the optimizers, all members together.
        seconds: of training, all members together.
        left: seconds until the end, as it looks now; inf before the first step.
        member: whose turn it is, from 0.
        check: the last point of its curve.
    """

    share: float
    steps: int
    seconds: float
    left: float
    member: int
    check: Check


class StreamRun:
    """All members of a run; see `ikgrad.training.train`."""

    def __init__(
        self,
        config: StreamConfig,
        robot: Robot | None,
        progress: Callable[[StreamProgress], object] | None,
        processes: Processes,
    ):
        self.config, self.progress, self.processes = config, progress, processes
        self.robot = load_robot(config.robot, base=config.base, tip=config.tip) if robot is None else robot
        if config.tensorboard:
            require_tensorboard()
        self.device = _own_device(config.device, processes)
        check_device(self.device)
        _check_threads(config.threads)
        _check_memory(config, self.robot, self.device)
        self.trainings = [self._training(seed) for seed in config.seeds]
        self.manifest: dict[str, Any] = {
            **vars(config),
            "robot fingerprint": self.robot.fingerprint,
            "ikgrad version": __version__,
            "torch version": str(torch.__version__),
        }
        self.folder: RunFolder | None = None
        self.events: Events | None = None
        self._before = 0.0  # seconds of the parts that were cut off
        self._start = self._saved = time.perf_counter()

    def open(self, folder: RunFolder, *, resume: bool) -> bool:
        """Begin the run folder or go on with it; True if the run is finished already."""
        self.folder = folder

        def begin() -> tuple[dict[str, Any] | None, bool]:
            state = folder.open(self.manifest, self.config, resume=resume)
            return state, state is None and resume and folder.report()["state"] == FINISHED

        state, finished = self.processes.on_first(begin)
        if state is not None:
            self._before = state["seconds"]
            for training, saved in zip(self.trainings, state["trainings"], strict=True):
                training.load_state_dict(saved)
        if self.config.tensorboard and self.processes.first:
            self.events = Events(folder.events, self.config.seeds, self._points)
        return finished

    def complete(self, checkpoint_seconds: float) -> StreamResult:
        """Train to the end."""
        self._start = self._saved = time.perf_counter()
        with _threads(self.config.threads), contextlib.ExitStack() as stack:
            if self.events is not None:
                stack.callback(self.events.close)
            for k, training in enumerate(self.trainings):
                try:
                    training.run(watch=lambda _, k=k: self._look(k, checkpoint_seconds))  # type: ignore[misc]
                except TrainingError as error:
                    raise self._failed(error) from error
            return self._finish(FINISHED)

    def finished(self, folder: RunFolder) -> StreamResult:
        """The result of a run that ended before."""
        report, models = folder.report(), folder.models(self.config.members)
        inverters = cast(tuple[IncrementInverter, ...], tuple(load_inverter(path, robot=self.robot) for path in models))
        curves = tuple(checks_from_csv(folder.history(), len(models)))
        members = tuple(
            StreamMember(found["seed"], found["steps"], found["seconds"], best_of(curve))
            for found, curve in zip(report["members"], curves, strict=True)
        )
        return StreamResult(self.config, inverters, members, curves, report["seconds"], folder.path)

    @property
    def seconds(self) -> float:
        """Of the run so far, checks and checkpoints included."""
        return self._before + time.perf_counter() - self._start

    def _training(self, seed: int) -> EndlessTraining:
        config = self.config
        stream = TaskStream(
            self.robot, batch_size=config.batch_size, spread=config.spread, label=config.labels, seed=seed
        )
        family = FAMILIES[config.model]
        return EndlessTraining(
            family(self.robot, seed=seed, **config.shape()).to(self.device),
            stream,
            minutes=config.minutes if config.steps is None else None,
            steps=config.steps,
            loss=_loss(config),
            lr=config.lr,
            checks=config.checks,
            processes=self.processes,
        )

    def _look(self, k: int, checkpoint_seconds: float) -> None:
        """After a step: tell, keep, and stop if the one who was told says so."""
        stop, due = False, time.perf_counter() - self._saved >= checkpoint_seconds
        try:
            if self.progress is not None and self.processes.first:
                self.progress(self._progress(k))
        except KeyboardInterrupt:
            stop = True
        decided = self.processes.from_first(2.0 * stop + due)
        if decided:
            self._save()
        if decided >= 2.0:
            raise KeyboardInterrupt

    def _save(self) -> None:
        """Write a checkpoint; only between steps."""
        self._saved = time.perf_counter()
        if self.folder is not None:
            self.processes.on_first(self._write_checkpoint)

    def _write_checkpoint(self) -> None:
        assert self.folder is not None
        if self.events is not None:
            self.events.write()  # first, so that what a checkpoint holds is always there
        states = [training.state_dict() for training in self.trainings]
        state = {"manifest": self.manifest, "seconds": self.seconds, "trainings": states}
        self.folder.save_state(state, checks_to_csv(self._curves()))

    def _progress(self, k: int) -> StreamProgress:
        share = sum(training.progress for training in self.trainings) / len(self.trainings)
        seconds = sum(training.seconds for training in self.trainings)
        if self.config.steps is None:
            left = (1.0 - share) * 60.0 * self.config.minutes * self.config.members
        else:
            left = seconds * (1.0 - share) / share if share > 0 else float("inf")
        steps = sum(training.step for training in self.trainings)
        return StreamProgress(share, steps, seconds, left, k, self.trainings[k].history[-1])

    def _failed(self, error: TrainingError) -> TrainingError:
        """Keep the last good weights, and say where they are."""
        if self.folder is None:
            return error
        self._finish(f"failed: {error}")
        return TrainingError(f"{error}; kept in {', '.join(map(str, self._kept(self.folder)))}")

    def _kept(self, folder: RunFolder) -> list[Path]:
        """Where the weights go of all members that have learned."""
        return folder.models(self.config.members)[: sum(bool(training.history) for training in self.trainings)]

    def _finish(self, state: str) -> StreamResult:
        seconds, curves = self.seconds, self._curves()
        inverters = tuple(training.inverter.to("cpu") for training in self.trainings)
        members = [
            StreamMember(seed, training.step, training.seconds, best_of(training.history))
            for seed, training in zip(self.config.seeds, self.trainings, strict=True)
            if training.history
        ]

        def write() -> None:
            assert self.folder is not None
            if self.events is not None:
                self.events.write()
            weights = dict(zip(self._kept(self.folder), inverters, strict=False))
            self.folder.finish(self._report(state, seconds, members), weights, checks_to_csv(curves))

        if self.folder is not None:
            self.processes.on_first(write)
        path = None if self.folder is None else self.folder.path
        return StreamResult(self.config, inverters, tuple(members), curves, seconds, path)

    def _curves(self) -> tuple[tuple[Check, ...], ...]:
        return tuple(tuple(training.history) for training in self.trainings)

    def _points(self, k: int, start: int) -> list[Point]:
        return check_points(self.trainings[k].history, start)

    def _report(self, state: str, seconds: float, members: list[StreamMember]) -> dict[str, Any]:
        return {
            **describe_run(self.config, self.robot, state, seconds, self.manifest),
            "network": self.trainings[0].inverter.settings(),
            "members": [asdict(member) for member in members],
        }


def _own_device(device: str, processes: Processes) -> str:
    """Each process has a GPU of its own, unless one is named."""
    return f"cuda:{os.environ.get('LOCAL_RANK', processes.rank)}" if device == "cuda" and processes.size > 1 else device


def _loss(config: StreamConfig) -> PoseLoss:
    """The family's own, but for what the settings say."""
    usual = LOSSES[FAMILIES[config.model]]
    shape = config.loss_shape or usual.shape
    delta = config.loss_delta or (usual.delta if shape == usual.shape else _DELTAS[shape])
    return PoseLoss(shape, delta, pose=config.pose_weight, limits=config.limit_weight, joints=config.joint_weight)


def _check_memory(config: StreamConfig, robot: Robot, device: str) -> None:
    family = FAMILIES[config.model]
    probe = family(robot, width=1, depth=1)
    usual = family(robot).settings()
    shape = {**usual, **config.shape()}
    check_stream_memory(
        len(probe.feature_names),
        probe.network.layers[-1].out_features,  # type: ignore[arg-type]
        width=shape["width"],
        depth=shape["depth"],
        rounds=shape.get("rounds", 1),
        batch_size=config.batch_size,
        looked_at=max(config.test_rows, 4000),
        members=config.members,
        available=available_memory(device),
    )


def _check_threads(count: int | None) -> None:
    there = os.cpu_count() or 1
    if count is not None and count > there:
        raise ConfigError(f"threads must be at most {there}, the processors of this machine, got {count}")


@contextlib.contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


__all__ = ["StreamProgress", "StreamRun"]
