"""From YAML files and options to frozen dataclasses of settings, or to one line that says what is wrong."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import re
from argparse import ArgumentError
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from ikgrad.errors import ConfigError

Config = TypeVar("Config")


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
    return make_config(cls, check_values(cls, read_mapping(Path(path)), where=path), where=path)


def check_values(cls: type, values: Mapping[str, Any], *, where: str | Path) -> dict[str, Any]:
    """Values converted to the types of the dataclass's fields, one key at a time so that the message names it.

    Args:
        cls: the dataclass.
        values: key to value, as a YAML file would give them.
        where: what the message begins with, such as the name of a file.

    Raises:
        ConfigError: an unknown key, or a value of the wrong type.
    """
    from jsonargparse import ArgumentParser

    types = {field.name: str(field.type) for field in dataclasses.fields(cls)}
    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(cls)
    checked: dict[str, Any] = {}
    for key, value in values.items():
        if key not in types:
            raise ConfigError(f"{where}: {unknown_key(str(key), types)}")
        kind = types[key]
        message = f"{where}: key '{key}' must be of type {kind}, got {value!r}"
        if value is None and "None" in kind:
            checked[key] = None
            continue
        if value is None or (isinstance(value, bool) and kind != "bool"):  # jsonargparse lets both pass
            raise ConfigError(message)
        try:
            checked[key] = parser.parse_object({key: value})[key]
        except ArgumentError as error:
            raise ConfigError(message) from error
    return checked


def make_config(cls: type[Config], values: Mapping[str, Any], *, where: str | Path) -> Config:
    """An instance of the dataclass from checked values; what makes no sense together is refused in its words."""
    try:
        return cls(**values)
    except ConfigError as error:  # from __post_init__, which does not know the file
        raise ConfigError(f"{where}: {error}") from error


def unknown_key(key: str, known: Mapping[str, Any]) -> str:
    """What to say of a key that does not exist: the nearest match, and what there is.

    Example:
        >>> unknown_key("sed", {"seed": 0})
        "unknown key 'sed'; did you mean 'seed'? (known: seed)"
    """
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"unknown key '{key}'{hint} (known: {', '.join(known)})"


def parse_value(text: str, *, where: str) -> Any:
    """A value as it would stand in a YAML file: ``[20]``, ``1e-3``, ``null``, ``{scheme: cube}``.

    Raises:
        ConfigError: it is no YAML.
    """
    from jsonargparse import get_loader
    from yaml import YAMLError  # type: ignore[import-untyped]

    try:
        return get_loader("yaml")(text)
    except YAMLError as error:
        raise ConfigError(f"{where}: not a YAML value: {' '.join(str(error).split())}") from error


def describe_keys(cls: type) -> dict[str, str]:
    """What the docstring says about every key, under "Attributes:", for the help of a command."""
    text = inspect.cleandoc(cls.__doc__ or "").split("Attributes:\n")[-1]
    entries = re.findall(r"^    (\w+): (.*(?:\n        .*)*)", text, flags=re.MULTILINE)
    return {key: " ".join(words.split()) for key, words in entries}


def read_mapping(path: Path) -> dict[str, Any]:
    """The keys of a YAML file, whatever they are.

    Raises:
        ConfigError: it cannot be read, or holds something else.
    """
    from jsonargparse import get_loader
    from yaml import YAMLError

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


def require(ok: bool, key: str, rule: str, value: object) -> None:
    """Refuse a value out of range."""
    if not ok:
        raise ConfigError(f"{key} {rule}, got {value}")


__all__ = [
    "check_values",
    "describe_keys",
    "load_config",
    "make_config",
    "parse_value",
    "read_mapping",
    "require",
    "unknown_key",
]
