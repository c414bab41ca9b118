"""A long run that survives being stopped: finished parts in ``<output>.partial/``, with a manifest of what they are.

Each part is written in one move, so that at any moment, also after ``kill -9`` or a power cut, the folder holds whole
parts only. The output itself is put together from the parts when all are there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.npy_table import npz_names
from ikgrad.files.places import in_one_move
from ikgrad.files.writers import Columns, NumpyWriter

MANIFEST = "manifest.json"


class PartialRun:
    """The finished parts of a run; begin or go on with `PartialRun.open`."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.finished = {int(path.stem[5:]) for path in folder.glob("part-*.npz") if path.stem[5:].isdigit()}

    @staticmethod
    def folder_of(output: Path) -> Path:
        """The folder that belongs to an output."""
        return output.with_name(output.name + ".partial")

    @classmethod
    def open(
        cls, output: Path, manifest: Mapping[str, Any], *, resume: bool = False, force: bool = False
    ) -> PartialRun:
        """Begin a run, or go on with one.

        Args:
            output: the file to be.
            manifest: all that the parts depend on, as flat JSON values under readable names.
            resume: go on with the parts that are there, if there are any.
            force: throw away the parts that are there, unless ``resume``.

        Raises:
            DataError: there are parts and neither is given; or they were made from something else.
        """
        run = cls(cls.folder_of(output))
        if not run.folder.exists():
            return run._begin(manifest)
        if resume:
            run._compare(manifest)
            return run
        if not force:
            raise DataError(f"{run.folder}: holds an unfinished run; --resume goes on with it, --force starts anew")
        run.discard()
        return cls(run.folder)._begin(manifest)

    def _begin(self, manifest: Mapping[str, Any]) -> PartialRun:
        self.folder.mkdir()
        with in_one_move(self.folder / MANIFEST) as temporary:
            temporary.write_text(json.dumps(dict(manifest), indent=1) + "\n", encoding="utf-8")
        return self

    def _compare(self, manifest: Mapping[str, Any]) -> None:
        path = self.folder / MANIFEST
        if not path.exists() and not self.finished:  # stopped before it had begun
            self.discard()
            self._begin(manifest)
            return
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
            assert isinstance(before, dict)
        except (ValueError, OSError, AssertionError) as error:
            raise DataError(f"{path}: cannot be read, so the run cannot go on; --force starts anew") from error
        differs = differences(before, manifest)
        if differs:
            raise DataError(
                f"{self.folder}: cannot go on with other settings: {'; '.join(differs)}; --force starts anew"
            )

    def _part(self, index: int) -> Path:
        return self.folder / f"part-{index:06d}.npz"

    def save(self, index: int, columns: Columns) -> None:
        """Keep a part."""
        with in_one_move(self._part(index), force=True) as temporary:
            writer = NumpyWriter(temporary, {})
            try:
                writer.append(columns)
                writer.finish()
            finally:
                writer.close()
        self.finished.add(index)

    def load(self, index: int) -> Columns:
        """A part that was kept.

        Raises:
            DataError: the part is damaged.
        """
        path = self._part(index)
        names = npz_names(path)
        try:
            with np.load(path, allow_pickle=False) as archive:
                return {name: archive[name] for name in names}
        except (ValueError, OSError, EOFError) as error:
            raise DataError(f"{path}: is damaged; remove it and --resume") from error

    def discard(self) -> None:
        """Remove the parts and the folder; anything else that somebody put there stays."""
        ours = [*self.folder.glob("part-*.npz"), *self.folder.glob(".*.tmp*"), self.folder / MANIFEST]
        for path in ours:
            path.unlink(missing_ok=True)
        self.finished.clear()
        try:
            self.folder.rmdir()
        except OSError as error:
            raise DataError(f"{self.folder}: cannot be removed: {error.strerror}") from error


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What changed between two manifests, in words; tuples are as good as lists.

    Example:
        >>> differences({"seed": 1, "q": [2]}, {"seed": 3, "q": (2,)})
        ['seed was 1, is 3']
    """
    then, now = json.loads(json.dumps(dict(before))), json.loads(json.dumps(dict(now)))
    names = dict.fromkeys([*now, *then])
    return [
        f"{name} was {_show(then.get(name))}, is {_show(now.get(name))}"
        for name in names
        if then.get(name) != now.get(name)
    ]


def _show(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
