"""Tasks for the tests of engines; here, because a worker process imports them by name."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ikgrad.errors import DataError, UnknownNameError
from ikgrad.jobs.task import Record


@dataclass(frozen=True)
class Noting:
    """Writes a file a name; dies, raises or stays for ever where it is told to.

    ``trouble`` maps a name to (kind, how often); a file counts the times, since a dead worker remembers nothing.
    """

    folder: Path
    trouble: dict[str, tuple[str, int]] = field(default_factory=dict)

    def warm_up(self) -> None:
        print("noise on stdout, where the answers go")

    def __call__(self, name: str) -> Record:
        kind, often = self.trouble.get(name, ("", 0))
        if kind and self._times(name) < often:
            with open(self.folder / f"{name}.times", "a") as file:
                file.write(f"{os.getpid()}\n")
            self._suffer(kind)
        (self.folder / f"{name}.done").write_text(str(os.getpid()))
        return {"name": name, "rows": len(name), "pid": os.getpid(), "threads": int(os.environ["OMP_NUM_THREADS"])}

    def _times(self, name: str) -> int:
        path = self.folder / f"{name}.times"
        return len(path.read_text().splitlines()) if path.exists() else 0

    def _suffer(self, kind: str) -> Any:
        if kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "data":
            raise DataError("x.parquet: is damaged")
        if kind == "unpicklable":
            raise UnknownNameError("robot", "pandda", ["panda"])
        if kind == "full":
            raise OSError(28, "No space left on device", "x.parquet")
        if kind == "bug":
            raise ZeroDivisionError("one over zero")
        while True:  # stay
            pass
