"""Where the rows of a training come from: a data set on disk, or one drawn for every member by a sampling scheme."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ikgrad.config import TrainConfig
from ikgrad.config.loading import require
from ikgrad.data import DataSet, Scheme, generate
from ikgrad.data.dataset import scheme_from_recipe
from ikgrad.errors import ConfigError, DataError
from ikgrad.robot import Robot

_SHARES = ("validation", "test")


def planned_rows(config: TrainConfig) -> int:
    """Rows that a sampling scheme is to draw for a member; 0 for a data set on disk, which is as large as it is.

    Raises:
        UnknownNameError: no such scheme.
        ConfigError: a setting that the scheme does not have, or that makes no sense.
    """
    return 0 if isinstance(config.data, str) else _scheme(config, config.seed)[0].count


def load_data(config: TrainConfig, robot: Robot) -> list[DataSet]:
    """One data set a member; the same one for all, if it is on disk or its scheme has a seed of its own.

    Raises:
        RobotError: the data are another robot's.
        DataError: the file cannot be used, nothing is left to learn from, or points are out of reach.
        ConfigError: a setting of the scheme makes no sense.
    """
    if isinstance(config.data, str):
        data = DataSet.load(Path(config.data), robot=robot)
        _refuse_empty(data, config.data)
        return [data] * config.members
    seeds = list(config.seeds) if "seed" not in config.data else [config.seed]
    sets = []
    for seed in seeds:
        scheme, shares = _scheme(config, seed)
        sets.append(generate(robot, scheme, **shares))
        _refuse_empty(sets[-1], f"data: scheme '{scheme.NAME}'")
    return sets if len(sets) == config.members else sets * config.members


def _scheme(config: TrainConfig, seed: int) -> tuple[Scheme, dict[str, float]]:
    assert not isinstance(config.data, str)
    recipe: dict[str, Any] = {"seed": seed, **config.data}
    shares = {key: recipe.pop(key) for key in _SHARES if key in recipe}
    for key, value in shares.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        require(number, f"data: key '{key}'", "must be a number", repr(value))
    try:
        return scheme_from_recipe(recipe), shares
    except ConfigError as error:
        raise ConfigError(f"data: {error}") from error


def _refuse_empty(data: DataSet, what: str) -> None:
    if len(data.train.q) == 0:
        raise DataError(f"{what}: no rows are left for training; there is nothing to learn from")


__all__ = ["load_data", "planned_rows"]
