"""Settings of experiments: flat frozen dataclasses, and `load_config`, which fills one from a YAML file.

This module does not import torch, so that a command can check its settings before anything heavy is loaded.
"""

from __future__ import annotations

import dataclasses
import difflib
from argparse import ArgumentError
from pathlib import Path
from typing import Any, Literal, TypeVar

from ikgrad.errors import ConfigError

Config = TypeVar("Config")


@dataclasses.dataclass(frozen=True)
class AppsConfig:
    """Settings of the KR 210 study, ``ikgrad reproduce apps``.

    Attributes:
        preset: settings of the seven motions: ``"reproduces"`` gives the paper's tables, ``"printed"`` is what the
            paper says it used.
        tol_pos: a pose counts as reached below this position error [m].
        tol_rot: and below this rotation error [rad].
        newton_max_steps: step limit of Newton-Raphson.
        learning_rates: the learning rates compared, on the plain sum of squares.
        learning_rate_max_steps: step limit of that comparison.
        random_starts: pairs of a random start and a random reachable pose; 0 leaves that part out.
        random_max_steps: step limit of APPS there.
        seed: seed of these pairs.
    """

    preset: Literal["reproduces", "printed"] = "reproduces"
    tol_pos: float = 1e-4
    tol_rot: float = 1e-4
    newton_max_steps: int = 100
    learning_rates: tuple[float, ...] = (1.0, 0.5, 0.1, 0.05, 0.01)
    learning_rate_max_steps: int = 6000
    random_starts: int = 1000
    random_max_steps: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        for key in ("tol_pos", "tol_rot", "newton_max_steps", "learning_rate_max_steps", "random_max_steps"):
            _require(getattr(self, key) > 0, key, "must be positive", getattr(self, key))
        _require(self.random_starts >= 0, "random_starts", "must not be negative", self.random_starts)
        _require(self.seed >= 0, "seed", "must not be negative", self.seed)
        good = len(self.learning_rates) > 0 and min(self.learning_rates) > 0
        _require(good, "learning_rates", "must be one or more positive numbers", list(self.learning_rates))


def load_config(cls: type[Config], path: str | Path) -> Config:
    """Read a YAML file into a dataclass of settings: every key is known and of the right type, or it is refused.

    Args:
        cls: the dataclass; keys that the file leaves out keep its defaults.
        path: the YAML file.

    Returns:
        An instance of ``cls``.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value is of the wrong type or out of range. The
            message names the file, the key and what is allowed.

    Example:
        >>> from ikgrad.config import AppsConfig, load_config
        >>> from ikgrad.resources import builtin_file
        >>> load_config(AppsConfig, builtin_file("configs", "apps")).random_starts
        1000
    """
    values = _read_mapping(Path(path))
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for key in values:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1, cutoff=0.5)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise ConfigError(f"{path}: unknown key '{key}'{hint} (known: {', '.join(known)})")
    try:
        return cls(**_check_types(cls, values, path))
    except ConfigError as error:  # from __post_init__, which does not know the file
        raise ConfigError(f"{path}: {error}" if str(path) not in str(error) else str(error)) from error


def _read_mapping(path: Path) -> dict[str, Any]:
    from jsonargparse import get_loader
    from yaml import YAMLError  # type: ignore[import-untyped]

    try:
        text = path.read_text(encoding="utf-8")
        values = get_loader("yaml")(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected lines of 'key: value', got {type(values).__name__}")
    return values


def _check_types(cls: type, values: dict[str, Any], path: str | Path) -> dict[str, Any]:
    """Values converted to the types of the dataclass's fields, one key at a time so that the message names it."""
    from jsonargparse import ArgumentParser

    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(cls)
    checked = {}
    for key, value in values.items():
        kind = next(field.type for field in dataclasses.fields(cls) if field.name == key)
        message = f"{path}: key '{key}' must be of type {kind}, got {value!r}"
        if value is None or (isinstance(value, bool) and kind != "bool"):  # jsonargparse lets both pass
            raise ConfigError(message)
        try:
            checked[key] = parser.parse_object({key: value})[key]
        except ArgumentError as error:
            raise ConfigError(message) from error
    return checked


def _require(ok: bool, key: str, rule: str, value: object) -> None:
    if not ok:
        raise ConfigError(f"{key} {rule}, got {value}")


__all__ = ["AppsConfig", "load_config"]
