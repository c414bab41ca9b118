"""A finished study as a file, so that its figures can be drawn again: one ``.npz`` with its records and its arrays.

Records are dataclasses and named tuples of this package, written by their names as JSON; tensors and arrays lie beside
it. Nothing is pickled: reading a file runs no code but the constructors of these records.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ikgrad.errors import DataError

SUFFIX = "_study.npz"  # after the paper's name
_ROOT, _TYPE = "study", "$"


def save_study(study: Any, path: str | Path) -> None:
    """Write a study.

    Args:
        study: a dataclass of this package.
        path: the file; the caller sees to it that it appears whole.
    """
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_encode(study, arrays))
    with open(path, "wb") as file:
        np.savez_compressed(file, **{_ROOT: np.array(text)}, **arrays)  # type: ignore[arg-type]


def load_study(path: str | Path) -> Any:
    """Read a study.

    Raises:
        DataError: it is no such file, or one of another version.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            return _decode(json.loads(str(archive[_ROOT])), archive)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except (OSError, zipfile.BadZipFile, ValueError, LookupError, TypeError, AttributeError, ImportError) as error:
        raise DataError(f"{path}: is no study of this version of ikgrad; reproduce it anew: {error}") from error


def _encode(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, torch.Tensor | np.ndarray):
        kind, array = ("tensor", value.detach().numpy()) if isinstance(value, torch.Tensor) else ("array", value)
        name = f"a{len(arrays)}"
        arrays[name] = array
        return {_TYPE: kind, "name": name}
    if isinstance(value, Enum):
        return {_TYPE: "enum", "of": _name(type(value)), "value": value.value}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _encode(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
        return {_TYPE: "record", "of": _name(type(value)), "fields": fields}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {
            _TYPE: "record",
            "of": _name(type(value)),
            "fields": _encode(dict(zip(value._fields, value, strict=True)), arrays)["items"],
        }
    if isinstance(value, tuple):
        return {_TYPE: "tuple", "items": [_encode(item, arrays) for item in value]}
    if isinstance(value, list):
        return [_encode(item, arrays) for item in value]
    if isinstance(value, Mapping):
        return {_TYPE: "dict", "items": {key: _encode(item, arrays) for key, item in value.items()}}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"cannot store {type(value).__name__}")


def _decode(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(value, list):
        return [_decode(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    kind = value[_TYPE]
    if kind in ("tensor", "array"):
        array = arrays[value["name"]]
        return torch.from_numpy(array) if kind == "tensor" else array
    if kind == "enum":
        return _class(value["of"], Enum)(value["value"])
    if kind == "tuple":
        return tuple(_decode(item, arrays) for item in value["items"])
    fields = {key: _decode(item, arrays) for key, item in value["fields" if kind == "record" else "items"].items()}
    if kind == "dict":
        return fields
    return _class(value["of"], tuple)(**fields)


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str, base: type) -> Any:
    """A record of this package, and nothing else that a file may ask for."""
    module, _, attribute = name.partition(":")
    if not module.startswith("ikgrad."):
        raise ValueError(f"{name} is no record of this package")
    found = getattr(import_module(module), attribute)
    if not (isinstance(found, type) and (dataclasses.is_dataclass(found) or issubclass(found, base))):
        raise ValueError(f"{name} is no record of this package")
    return found


__all__ = ["SUFFIX", "load_study", "save_study"]
