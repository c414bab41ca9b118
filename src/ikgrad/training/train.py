"""`train`: from settings to trained inverters, in memory or in a run folder that survives being killed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ikgrad.config import StreamConfig, TrainConfig
from ikgrad.config.training import AnyConfig, train_config
from ikgrad.data import DataSet
from ikgrad.errors import ConfigError
from ikgrad.robot import Robot
from ikgrad.training.jobs import job_of_torchrun
from ikgrad.training.processes import Processes, processes_of_torchrun, world_size
from ikgrad.training.result import TrainResult
from ikgrad.training.run import Run, TrainProgress
from ikgrad.training.run_folder import RunFolder
from ikgrad.training.stream_result import StreamResult
from ikgrad.training.stream_run import StreamProgress, StreamRun


def train(
    config: AnyConfig | Mapping[str, Any] | str | Path | None = None,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Callable[[Any], object] | None = None,
    checkpoint_seconds: float = 30.0,
    **options: Any,
) -> TrainResult | StreamResult:
    """Train inverters as settings say: ``ik.train(robot="arm.urdf", tip="tool0", minutes=15)``.

    ``model`` decides how. ``"unrolled"`` (the default) and ``"increment"`` start from the present joints and learn from
    samples without end, for some minutes or steps. ``"classic"`` is a network that learns a data set in epochs. Every
    inverter ends with the weights of its smallest validation error. With a run folder, a run that was killed at any
    moment goes on when it is resumed; it ends with the very same weights, bit for bit, as one that was left alone,
    unless the budget is one of minutes.

    Started by ``torchrun``, the processes share the batches of the first two models; the first one alone writes. If
    torchrun starts them again, because one has died, they go on from the last checkpoint without ``resume``.

    Args:
        config: settings, or a YAML file of them; default: those of `StreamConfig`.
        out: run folder to make, see `ikgrad.training.run_folder`; None: nothing is written.
        resume: go on with the run in ``out``, if there is one.
        force: replace a run in ``out``.
        progress: called between steps with a `StreamProgress`, between epochs with a `TrainProgress`. A
            KeyboardInterrupt that it raises ends the training with a checkpoint.
        checkpoint_seconds: time between checkpoints.
        options: settings to change, such as ``minutes=3``; ``robot`` may be a `Robot`, ``data`` a `DataSet`.

    Returns:
        `StreamResult`, for ``classic`` `TrainResult`: both have ``inverter``, ``inverters``, ``members``, ``curves``,
        ``seconds`` and ``folder``.

    Raises:
        ConfigError: a setting is unknown, of the wrong type or of another model, or makes no sense; or the training
            does not fit in memory.
        UnknownNameError: no such robot, scheme, optimizer, activation or encoding.
        RobotError: the data are another robot's, or the robot cannot be used.
        DataError: the data cannot be used, or the run folder cannot.
        TrainingError: the loss is not finite any more; the last good weights are in the run folder.

    Example:
        >>> import ikgrad as ik
        >>> result = ik.train(robot="ur5e", width=32, steps=40, batch_size=256)
        >>> result.members[0].best.position_mm < result.curves[0][0].position_mm
        True
        >>> result = ik.train(model="classic", robot="panda", data={"scheme": "joint_box", "count": 300}, epochs=20)
        >>> result.test_errors[0].joint_mse < 1e-2
        True
    """
    settings, robot, data = _resolve(config, options)
    folder = None if out is None else RunFolder(out)
    if folder is None and resume:
        raise ConfigError("resume needs out, the folder of the run that was cut off")
    if folder is None and settings.tensorboard:
        raise ConfigError("tensorboard needs out, a run folder to write the events to")

    def work(processes: Processes) -> TrainResult | StreamResult:
        go_on = False
        if folder is not None:
            job = job_of_torchrun(processes)
            go_on = processes.on_first(lambda: folder.check(resume=resume, force=force, job=job))
        run: Run | StreamRun
        if isinstance(settings, StreamConfig):
            run = StreamRun(settings, robot, progress, processes)
        else:
            run = Run(settings, robot, data, progress)
        if folder is not None and run.open(folder, resume=go_on):
            return run.finished(folder)
        return run.complete(checkpoint_seconds)

    if isinstance(settings, TrainConfig):
        if world_size() > 1:
            raise ConfigError("model classic trains in one process; start it without torchrun")
        return work(Processes())
    with processes_of_torchrun() as processes:
        return work(processes)


def _resolve(config: Any, options: dict[str, Any]) -> tuple[AnyConfig, Robot | None, DataSet | None]:
    """Settings, with objects that were given in the place of names."""
    robot, data = options.get("robot"), options.get("data")
    if isinstance(robot, Robot):
        options |= {"robot": robot.name, "base": robot.base, "tip": robot.tip}
    if isinstance(data, DataSet):
        split = data.recipe["split"]
        options["data"] = {**{k: v for k, v in data.recipe.items() if k != "split"}}
        count = sum(split.values())
        options["data"] |= {part: split[part] / count for part in ("validation", "test")}
    settings = train_config(config, options)
    return settings, robot if isinstance(robot, Robot) else None, data if isinstance(data, DataSet) else None


__all__ = ["StreamProgress", "StreamResult", "TrainProgress", "TrainResult", "train"]
