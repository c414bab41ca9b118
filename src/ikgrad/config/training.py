"""Settings of a training: what ``ik.train`` and ``ikgrad train`` read."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from ikgrad.config.loading import check_values, make_config, read_mapping, require
from ikgrad.config.settings import TrainingSettings
from ikgrad.config.stream import StreamConfig
from ikgrad.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class TrainConfig(TrainingSettings):
    """A classic inverter, what it learns from, and how, ``configs/denso_feedback.yaml``.

    Attributes:
        robot: built-in name, or path of a URDF file.
        base: link in which poses are given; null: the root link.
        tip: link whose pose is meant; null: the only leaf link.
        model: classic.
        feedback: also look at the present joints.
        hidden: units of each hidden layer.
        activation: of the hidden layers: tanh, logistic, relu, silu, gelu or linear.
        encoding: of rotations: rotation_vector, roll_pitch_yaw, quaternion or rotation_6d.
        bounded: answers never leave the joint limits.
        data: path of a data set, or a sampling scheme with its settings, such as {scheme: joint_box, count: 4000}; the
            shares 'validation' and 'test' (0.15 each) stand there too. A mapping without 'scheme' changes the keys that
            it names. Without a 'seed' every member has samples of its own, drawn with its seed.
        loss: joint is the mean squared joint error.
        optimizer: levenberg_marquardt, backprop, delta_bar_delta, quickprop, or a class of torch.optim such as Adam.
        lr: learning rate; null: the optimizer's own.
        optimizer_options: further arguments of the optimizer, such as {mu: 0.01}.
        batch_size: rows a step, in a new order every epoch; null: all rows, in fixed order.
        epochs: at most.
        patience: stop after so many epochs in a row without a smaller validation error; null: never.
        seed: of the first weights, the order of the rows, and the samples.
        members: networks, with seeds of their own from 'seed' on.
        device: cpu, cuda or cuda:1.
        dtype: of weights, float64 or float32.
        tensorboard: also write events for TensorBoard.
    """

    robot: str = ""
    base: str | None = None
    tip: str | None = None
    model: Literal["classic"] = "classic"
    feedback: bool = False
    hidden: tuple[int, ...] = (10,)
    activation: str = "tanh"
    encoding: str = "rotation_vector"
    bounded: bool = False
    data: str | dict[str, Any] = dataclasses.field(default_factory=lambda: {"scheme": "joint_box"})
    loss: Literal["joint"] = "joint"
    optimizer: str = "levenberg_marquardt"
    lr: float | None = None
    optimizer_options: dict[str, Any] = dataclasses.field(default_factory=dict)
    batch_size: int | None = None
    epochs: int = 100
    patience: int | None = None
    seed: int = 0
    members: int = 1
    device: str = "cpu"
    dtype: Literal["float64", "float32"] = "float64"
    tensorboard: bool = False

    def __post_init__(self) -> None:
        counts = ("batch_size", "epochs", "patience")
        self._check_shared(counts=counts, positive=("lr",), seeds_end=2**63 - 1, end_says="2^63 - 1")
        good = len(self.hidden) > 0 and min(self.hidden) > 0
        require(good, "hidden", "must be one or more positive numbers", list(self.hidden))
        given = isinstance(self.data, str) or "scheme" in self.data
        require(given, "data", "must be the path of a data set or name a 'scheme'", self.data)
        if self.optimizer == "levenberg_marquardt":
            require(
                self.batch_size is None,
                "batch_size",
                "must be null: levenberg_marquardt takes all rows at once",
                self.batch_size,
            )


AnyConfig = TrainConfig | StreamConfig
_CLASSES: dict[str, type[TrainConfig] | type[StreamConfig]] = {
    "unrolled": StreamConfig,
    "increment": StreamConfig,
    "classic": TrainConfig,
}
MODELS = tuple(_CLASSES)


def train_config(source: AnyConfig | Mapping[str, Any] | str | Path | None, options: Mapping[str, Any]) -> AnyConfig:
    """Settings from a file, a mapping or other settings, with some of them changed.

    Args:
        source: where to begin; a string or path is a YAML file. None: the defaults.
        options: keys to change, as in a YAML file. ``data`` without a ``scheme`` changes the keys that it names.

    Returns:
        `TrainConfig` if ``model`` is classic, else `StreamConfig`; without ``model`` it is unrolled.

    Raises:
        ConfigError: an unknown key, one that belongs to another model, a wrong type, or a value out of range.

    Example:
        >>> start = TrainConfig(robot="ur5e", data={"scheme": "cube", "count": 500})
        >>> train_config(start, {"hidden": [20], "data": {"count": 900}}).data
        {'scheme': 'cube', 'count': 900}
        >>> train_config(None, {"robot": "arm.urdf", "minutes": 3}).model
        'unrolled'
    """
    where: str | Path = "settings"
    if isinstance(source, str | Path):
        values, where = read_mapping(Path(source)), source
    else:
        values = dict(vars(source) if isinstance(source, AnyConfig) else source or {})
    model = _model(options.get("model", values.get("model", "unrolled")), "options" if "model" in options else where)
    cls = _CLASSES[model]
    if not isinstance(source, cls):
        values = _check(cls, model, values, where)
    changes = _check(cls, model, options, "options")
    before, now = values.get("data"), changes.get("data")
    if isinstance(now, dict) and "scheme" not in now:
        if not isinstance(before, dict):
            raise ConfigError(f"options: key 'data' must name a 'scheme', or change keys of one, got {now}")
        changes["data"] = {**before, **now}
    return make_config(cls, {**values, **changes}, where=where)


def _model(name: Any, where: str | Path) -> str:
    if isinstance(name, str) and name in _CLASSES:
        return name
    close = difflib.get_close_matches(str(name), MODELS, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise ConfigError(f"{where}: key 'model' must be {', '.join(MODELS[:-1])} or {MODELS[-1]}, got {name!r}{hint}")


def _check(cls: type[AnyConfig], model: str, values: Mapping[str, Any], where: str | Path) -> dict[str, Any]:
    """Checked values; a key of the other kind of models is named as such, rather than as unknown."""
    own = {field.name for field in dataclasses.fields(cls)}
    for key in values:
        owners = [name for name, other in _CLASSES.items() if any(f.name == key for f in dataclasses.fields(other))]
        if key not in own and owners:
            belongs = f"model {owners[0]}" if len(owners) == 1 else f"the models {' and '.join(owners)}"
            raise ConfigError(
                f"{where}: key '{key}' belongs to {belongs}, but model is {model}; leave it out, or say "
                f"'model: {owners[0]}'"
            )
    return check_values(cls, values, where=where)


__all__ = ["AnyConfig", "MODELS", "TrainConfig", "train_config"]
