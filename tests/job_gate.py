"""A task that a test can hold up; apart from the others because it needs torch."""

from __future__ import annotations

import os
import time
from pathlib import Path

from ikgrad.jobs.solving import SolveTask
from ikgrad.jobs.task import Record


class GatedSolve(SolveTask):
    """Stops before partitions for which there is a file NAME.hold in $GATE; notes who comes by in NAME.pids."""

    def __call__(self, name: str) -> Record:
        gate = Path(os.environ["GATE"])
        with open(gate / f"{name}.pids", "a") as file:
            file.write(f"{os.getpid()}\n")
        while (gate / f"{name}.hold").exists():
            time.sleep(0.01)
        return super().__call__(name)
