"""Work that is too much for one file: folders of partitions in, folders of partitions out, by several processes.

A `Task` does one partition and may be sent to any process; an engine hands names of partitions to processes and gives
back a record for each, in order of completion (`run_local`). An output folder says what it belongs to and which of its
partitions are finished, so that a job can be stopped, resumed, shared out and checked; see `ikgrad.jobs.folder`.
"""

from ikgrad.jobs.local import run_local
from ikgrad.jobs.task import Record, Task

__all__ = ["Record", "Task", "run_local"]
