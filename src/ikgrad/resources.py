"""Where built-in files lie: inside an installed wheel, or at the root of a checkout."""

from __future__ import annotations

from pathlib import Path

from ikgrad.errors import UnknownNameError

_PACKAGE = Path(__file__).resolve().parent


def data_folder(kind: str) -> Path:
    """Folder of built-in files; ``kind`` is ``"urdf"`` or ``"configs"``."""
    installed = _PACKAGE / "_data" / kind
    return installed if installed.is_dir() else _PACKAGE.parents[1] / kind


def builtin_names(kind: str) -> list[str]:
    """Names (file stems) of the built-in files of a kind, sorted."""
    return sorted(path.stem for path in data_folder(kind).iterdir() if path.suffix in {".urdf", ".yaml"})


def builtin_file(kind: str, name: str) -> Path:
    """Path of a built-in file by its name.

    Raises:
        UnknownNameError: no such file.
    """
    for path in data_folder(kind).iterdir():
        if path.stem == name and path.suffix in {".urdf", ".yaml"}:
            return path
    what = {"urdf": "robot", "configs": "configuration"}[kind]
    raise UnknownNameError(what, name, builtin_names(kind))


def find_config(name: str) -> Path:
    """A configuration file: an existing path, or a built-in name such as ``denso_feedback``.

    A path that does not exist is returned as it is, for the reader to refuse.

    Raises:
        UnknownNameError: a bare name that is not built in.
    """
    path = Path(name)
    return path if path.exists() or path.suffix or len(path.parts) > 1 else builtin_file("configs", name)
