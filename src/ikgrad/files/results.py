"""The results in a joint file of ``ikgrad solve``: errors, success, reason, steps; the joints need a robot."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.joints import RESULTS
from ikgrad.files.parquet_table import parquet_column
from ikgrad.files.writers import Columns

_WORDS = {"true": True, "1": True, "false": False, "0": False}


def read_results(path: str | Path, kind: str) -> Columns:
    r"""The columns of `RESULTS`.

    Args:
        path: the file.
        kind: ``.csv``, ``.parquet`` or ``.npz``.

    Returns:
        ``position_error_m``, ``rotation_error_rad`` (N,) float64, ``success`` bool, ``reason`` text, ``steps`` int64.

    Raises:
        DataError: a column is missing, or a value is of another kind.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp(), "joints.csv")
        >>> _ = path.write_text(
        ...     "a,position_error_m,rotation_error_rad,success,reason,steps\n0.1,1e-9,2e-9,True,converged,7\n")
        >>> read_results(path, ".csv")["reason"].tolist()
        ['converged']
    """
    path = Path(path)
    read: dict[str, Callable[[Path], Mapping[str, Any]]] = {".csv": _csv, ".parquet": _parquet, ".npz": _npz}
    try:
        raw = read[kind](path)
        columns: Columns = {
            "position_error_m": np.asarray(raw["position_error_m"], dtype=np.float64),
            "rotation_error_rad": np.asarray(raw["rotation_error_rad"], dtype=np.float64),
            "success": np.array([_WORDS[str(value).lower()] for value in raw["success"]], dtype=bool),
            "reason": np.asarray(raw["reason"], dtype=str),
            "steps": np.asarray(raw["steps"], dtype=np.float64).astype(np.int64),
        }
    except KeyError as error:
        raise DataError(f"{path}: no column, or no truth value, {error}; `ikgrad solve` writes such files") from error
    except (ValueError, IndexError, OSError) as error:
        raise DataError(f"{path}: is damaged: {error}") from error
    if not len(columns["reason"]):
        raise DataError(f"{path}: has no rows")
    return columns


def _csv(path: Path) -> dict[str, list[str]]:
    with open(path, encoding="utf-8-sig", errors="replace", newline="") as file:
        rows = csv.reader(file)
        names = [name.strip() for name in next(rows)]
        places = {name: names.index(name) for name in RESULTS if name in names}
        found: dict[str, list[str]] = {name: [] for name in places}
        for row in rows:
            for name, place in places.items() if row else ():
                found[name].append(row[place])
    return found


def _parquet(path: Path) -> dict[str, np.ndarray]:
    return {name: parquet_column(path, name) for name in RESULTS}


def _npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in RESULTS}


__all__ = ["read_results"]
