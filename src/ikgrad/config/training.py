"""Settings of a training: what ``ik.train`` and ``ikgrad train`` read."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from ikgrad.config.loading import check_values, make_config, read_values, require
from ikgrad.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """An inverter, what it learns from, and how, ``configs/denso_feedback.yaml``; every key is an option too.

    Attributes:
        robot: built-in name, or path of a URDF file.
        base: link in which poses are given; null: the root link.
        tip: link whose pose is meant; null: the only leaf link.
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
        require(self.robot != "", "robot", "must be the name of a built-in robot or the path of a URDF file", "nothing")
        good = len(self.hidden) > 0 and min(self.hidden) > 0
        require(good, "hidden", "must be one or more positive numbers", list(self.hidden))
        for key in ("batch_size", "epochs", "patience", "members"):
            value = getattr(self, key)
            require(value is None or value > 0, key, "must be at least 1", value)
        require(0 <= self.seed < 2**63 - self.members, "seed", "must be from 0 to 2^63 - 1", self.seed)
        require(self.lr is None or 0 < self.lr < float("inf"), "lr", "must be positive and finite", self.lr)
        device = re.fullmatch(r"cpu|cuda(:\d+)?", self.device)
        require(device is not None, "device", "must be cpu, cuda or cuda:N", repr(self.device))
        given = isinstance(self.data, str) or "scheme" in self.data
        require(given, "data", "must be the path of a data set or name a 'scheme'", self.data)
        if self.optimizer == "levenberg_marquardt":
            require(
                self.batch_size is None,
                "batch_size",
                "must be null: levenberg_marquardt takes all rows at once",
                self.batch_size,
            )

    @property
    def seeds(self) -> range:
        """One for each member."""
        return range(self.seed, self.seed + self.members)

    def to_yaml(self) -> str:
        """The settings as a YAML file that gives the same settings again."""
        from yaml import safe_dump  # type: ignore[import-untyped]

        values = {key: _plain(value) for key, value in vars(self).items()}
        return safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def train_config(
    source: TrainConfig | Mapping[str, Any] | str | Path | None, options: Mapping[str, Any]
) -> TrainConfig:
    """Settings from a file, a mapping or other settings, with some of them changed.

    Args:
        source: where to begin; a string or path is a YAML file. None: the defaults.
        options: keys to change, as in a YAML file. ``data`` without a ``scheme`` changes the keys that it names.

    Raises:
        ConfigError: an unknown key, a wrong type, or a value out of range.

    Example:
        >>> start = TrainConfig(robot="ur5e", data={"scheme": "cube", "count": 500})
        >>> train_config(start, {"hidden": [20], "data": {"count": 900}}).data
        {'scheme': 'cube', 'count': 900}
    """
    where: str | Path = "settings"
    if source is None:
        values: dict[str, Any] = {}
    elif isinstance(source, TrainConfig):
        values = {field.name: getattr(source, field.name) for field in dataclasses.fields(source)}
    elif isinstance(source, Mapping):
        values = check_values(TrainConfig, source, where=where)
    else:
        values, where = read_values(TrainConfig, source), source
    changes = check_values(TrainConfig, options, where="options")
    before, now = values.get("data"), changes.get("data")
    if isinstance(now, dict) and "scheme" not in now:
        if not isinstance(before, dict):
            raise ConfigError(f"options: key 'data' must name a 'scheme', or change keys of one, got {now}")
        changes["data"] = {**before, **now}
    return make_config(TrainConfig, {**values, **changes}, where=where)


def _plain(value: Any) -> Any:
    """Tuples as lists, which YAML knows."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


__all__ = ["TrainConfig", "train_config"]
