"""`train`: from settings to trained inverters, in memory or in a run folder that survives being killed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ikgrad.config import TrainConfig
from ikgrad.config.training import train_config
from ikgrad.data import DataSet
from ikgrad.errors import ConfigError
from ikgrad.robot import Robot
from ikgrad.training.result import TrainResult
from ikgrad.training.run import Run, TrainProgress
from ikgrad.training.run_folder import RunFolder


def train(
    config: TrainConfig | Mapping[str, Any] | str | Path | None = None,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Callable[[TrainProgress], object] | None = None,
    checkpoint_seconds: float = 30.0,
    **options: Any,
) -> TrainResult:
    """Train inverters as settings say, and judge them on rows that they have not seen.

    Every inverter ends with the weights of its smallest validation error. With a run folder, a run that was killed at
    any moment and is resumed ends with the very same weights, bit for bit, as one that was left alone.

    Args:
        config: settings, or a YAML file of them; default: the defaults of `TrainConfig`.
        out: run folder to make, see `ikgrad.training.run_folder`; None: nothing is written.
        resume: go on with the run in ``out``, if there is one.
        force: replace a run in ``out``.
        progress: called between epochs. A KeyboardInterrupt that it raises ends the training with a checkpoint.
        checkpoint_seconds: time between checkpoints.
        options: settings to change, such as ``hidden=(20,)``; ``robot`` may be a `Robot`, ``data`` a `DataSet`.

    Raises:
        ConfigError: a setting is unknown, of the wrong type, or makes no sense; or the training does not fit in memory.
        UnknownNameError: no such robot, scheme, optimizer, activation or encoding.
        RobotError: the data are another robot's, or the robot cannot be used.
        DataError: the data cannot be used, or the run folder cannot.
        TrainingError: the loss is not finite any more; the last good weights are in the run folder.

    Example:
        >>> import ikgrad as ik
        >>> result = ik.train(robot="panda", data={"scheme": "joint_box", "count": 300}, epochs=20)
        >>> result.test_errors[0].joint_mse < 1e-2
        True
    """
    settings, robot, data = _resolve(config, options)
    folder = None if out is None else RunFolder(out)
    if folder is not None:
        folder.check(resume=resume, force=force)
    elif resume:
        raise ConfigError("resume needs out, the folder of the run that was cut off")
    elif settings.tensorboard:
        raise ConfigError("tensorboard needs out, a run folder to write the events to")
    run = Run(settings, robot, data, progress)
    if folder is not None and run.open(folder, resume=resume):
        return run.finished(folder)
    return run.complete(checkpoint_seconds)


def _resolve(config: Any, options: dict[str, Any]) -> tuple[TrainConfig, Robot | None, DataSet | None]:
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


__all__ = ["TrainProgress", "TrainResult", "train"]
