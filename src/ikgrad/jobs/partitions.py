"""A folder of partitions: Parquet files side by side, ``NAME.parquet`` each, and how they are shared out."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ikgrad.errors import ConfigError, DataError
from ikgrad.files.parquet_table import ParquetTable
from ikgrad.files.partial import differences
from ikgrad.files.writers import SUFFIXES

SUFFIX = ".parquet"
LONGEST = 150  # bytes of a name; a file system takes 255, and temporary files have longer names


def list_names(folder: Path) -> list[str]:
    """Names of the partitions in a folder, in order; files whose names begin with _ or . are passed over, as ever.

    Raises:
        DataError: no folder, nothing in it, folders inside, or files that may be meant and cannot be read.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder")
    names = []
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        path = Path(entry)
        if entry.name[0] in "_.":
            continue
        if entry.is_dir():
            raise DataError(f"{path}: is a folder inside; partitions lie side by side in one folder")
        if path.suffix == SUFFIX:
            names.append(path.stem)
        elif path.suffix.lower() in SUFFIXES:
            raise DataError(f"{path}: a folder holds partitions named NAME{SUFFIX} only; move this one elsewhere")
    if not names:
        raise DataError(f"{folder}: holds no {SUFFIX} files")
    long = next((name for name in names if len(os.fsencode(name)) > LONGEST), None)
    if long is not None:
        raise DataError(f"{folder}: the name '{long[:20]}...' is longer than {LONGEST} bytes; rename the file")
    return names


def look_at(path: Path, columns: Sequence[str]) -> dict[str, Any]:
    """What a job's description says of an input: rows, of which there may be none, bytes, and a hash of the footer.

    A Parquet footer has the sizes and the extremes of all columns, so it hardly stays the same when a number changes.

    Raises:
        DataError: not a Parquet file, or a wrong column.
    """
    table = ParquetTable(path, columns, empty=True)
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 8))
        length = int.from_bytes(file.read(4), "little")  # the last eight bytes: length of the footer, PAR1
        file.seek(max(0, size - 8 - length))
        footer = hashlib.sha256(file.read()).hexdigest()[:16]
    return {"rows": table.total, "bytes": size, "footer": footer}


def changed_partitions(before: dict[str, Any], now: dict[str, Any], limit: int = 3) -> list[str]:
    """What differs between two lists of partitions, in words, the first few.

    Example:
        >>> changed_partitions({"a": {"rows": 9}, "c": {"rows": 9}}, {"b": {"rows": 9}, "c": {"rows": 8}})
        ["partition 'a' is gone", "partition 'b' is new", "rows of partition 'c' was 9, is 8"]
    """
    lines = []
    for name in sorted({*before, *now}):
        if name not in now:
            lines.append(f"partition '{name}' is gone")
        elif name not in before:
            lines.append(f"partition '{name}' is new")
        else:
            differs = differences(before[name], now[name])
            lines += [difference.replace(" was", f" of partition '{name}' was", 1) for difference in differs]
    return lines if len(lines) <= limit else [*lines[:limit], f"and {len(lines) - limit:,} more differences"]


@dataclass(frozen=True)
class Shard:
    """One of several processes that share a job: number ``index`` (from 1) of ``count``."""

    index: int
    count: int

    @staticmethod
    def parse(text: str) -> Shard:
        """From ``i/N``.

        Raises:
            ConfigError: it is no such thing.

        Example:
            >>> Shard.parse("2/8")
            Shard(index=2, count=8)
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        shard = Shard(*map(int, match.groups())) if match else None
        if shard is None or not 1 <= shard.index <= shard.count:
            raise ConfigError(f"expected a shard i/N with i from 1 to N, like 1/8 to 8/8, got '{text}'")
        return shard

    def of(self, names: Sequence[str]) -> list[str]:
        """Every ``count``-th name, beginning with number ``index``: each belongs to exactly one shard.

        Example:
            >>> [Shard(i, 2).of(["a", "b", "c"]) for i in (1, 2)]
            [['a', 'c'], ['b']]
        """
        return list(names[self.index - 1 :: self.count])
