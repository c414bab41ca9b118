"""Where inverters lie: in a folder, in a run folder, or in the package under the name of a built-in robot."""

from __future__ import annotations

from pathlib import Path

from ikgrad.errors import DataError, UnknownNameError
from ikgrad.resources import builtin_names, data_folder

WEIGHTS, CONFIG = "model.safetensors", "config.json"
READY_MADE = "inverters"  # kind of built-in file: a folder a robot


def ready_made() -> list[str]:
    """Names of the built-in robots for which weights come with the package, sorted."""
    folder = data_folder(READY_MADE)
    return sorted(path.parent.name for path in folder.glob(f"*/{CONFIG}")) if folder.is_dir() else []


def find_inverter(name: str | Path) -> Path:
    """The folder with ``config.json`` and ``model.safetensors``.

    Args:
        name: that folder; a run folder of `ikgrad train`, whose ``model`` is taken; or, if there is no such folder, a
            name of `ready_made`.

    Raises:
        DataError: the folder holds no inverter, or several.
        UnknownNameError: no folder, and no ready-made inverter of this name.

    Example:
        >>> find_inverter("panda").name
        'panda'
    """
    folder = Path(name)
    if folder.is_dir():
        return _in_folder(folder)
    if len(folder.parts) != 1:
        return folder  # for the reader to refuse
    if str(name) in ready_made():
        return data_folder(READY_MADE) / folder
    if str(name) in builtin_names("urdf"):
        raise DataError(
            f"no weights for robot '{name}' come with the package (there are: {', '.join(ready_made())}); train them: "
            f"ikgrad train --robot {name} --model unrolled --out runs/{name}, and name that folder"
        )
    raise UnknownNameError("folder or ready-made inverter", str(name), ready_made())


def _in_folder(folder: Path) -> Path:
    for candidate in (folder, folder / "model"):
        if (candidate / CONFIG).is_file():
            return candidate
    members = sorted(path.name for path in folder.glob("model-*"))
    if members:
        raise DataError(f"{folder}: holds {len(members)} members; name one, such as {folder / members[0]}")
    if folder.name in ready_made() and len(folder.parts) == 1:
        raise DataError(
            f"{folder}: this folder holds no trained inverter, and hides the ready-made one of that name; work in "
            "another directory"
        )
    raise DataError(f"{folder}: holds no trained inverter")


__all__ = ["CONFIG", "READY_MADE", "WEIGHTS", "find_inverter", "ready_made"]
