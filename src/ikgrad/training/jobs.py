"""Which job of torchrun this is: a restarted one goes on with its run, a new one does not take over another's.

Torchrun starts the same command again when a process dies or a node comes or goes. Its restart counter does not count
the latter, and a mistake is restarted like any failure, so neither tells whether the run in the folder is the job's
own. The folder's record does: the job's id, and when it was written. If one of the torchrun processes is older than
that, the run was begun in its lifetime.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ikgrad.training.processes import Processes


@dataclass(frozen=True)
class Job:
    """A job of torchrun.

    Attributes:
        id: ``--rdzv-id``, made up by ``--standalone``; ``none`` without either.
        since: when its oldest torchrun process was started [s since 1970].

    Example:
        >>> job = Job("arm", since=100.0)
        >>> job.began({"id": "arm", "time": 107.0}), job.began({"id": "arm", "time": 50.0}), job.began(None)
        (True, False, False)
    """

    id: str
    since: float

    def record(self) -> dict[str, Any]:
        """What the run folder keeps."""
        return {"id": self.id, "time": time.time()}

    def began(self, record: Mapping[str, Any] | None) -> bool:
        """True if this job wrote the record."""
        return record is not None and record["id"] == self.id and self.since < record["time"]


def job_of_torchrun(processes: Processes) -> Job | None:
    """The job that all processes belong to; None if torchrun did not start them."""
    restarts = os.environ.get("TORCHELASTIC_RESTART_COUNT")
    if restarts is None:
        return None
    started = _started(os.getppid())
    if started is None:  # no such system files: trust the counter
        started = 0.0 if int(restarts) > 0 else time.time()
    return Job(os.environ.get("TORCHELASTIC_RUN_ID", "none"), processes.least(started))


def _started(process: int) -> float | None:
    """When a process was started [s since 1970]; None where the system does not say."""
    try:
        ticks = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19])
        up = float(Path("/proc/uptime").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
    return time.time() - (up - ticks / os.sysconf("SC_CLK_TCK"))


__all__ = ["Job", "job_of_torchrun"]
