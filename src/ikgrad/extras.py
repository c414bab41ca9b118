"""Packages that are not always there: one function that imports them, or says which extra brings them."""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType

from ikgrad.errors import MissingExtraError


def need(module: str, *, extra: str, what: str) -> ModuleType:
    """Import a package that only an extra brings.

    Args:
        module: its name, dotted if a part of it is wanted.
        extra: that brings it, see pyproject.toml.
        what: the feature, in the plural, for the message: "Parquet files".

    Raises:
        MissingExtraError: the package, or one that it needs itself, is not installed.

    Example:
        >>> need("json", extra="data", what="JSON files").__name__
        'json'
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = (error.name or module).partition(".")[0]
        raise MissingExtraError(what, package, extra) from error


def check(module: str, *, extra: str, what: str) -> None:
    """The same question before slow work, without the time that the import takes.

    Raises:
        MissingExtraError: the package is not installed.
    """
    if importlib.util.find_spec(module) is None:
        raise MissingExtraError(what, module, extra)


__all__ = ["check", "need"]
