"""What an engine runs: a task that does one partition at a time, wherever it is sent."""

from __future__ import annotations

from typing import Any, Protocol

Record = dict[str, Any]
"""What is known about a finished partition; a JSON object.

``name``, ``rows``, ``bytes`` and ``sha256`` of its file, ``counts`` (what the rows say, summed up), ``seconds`` (where
the time went), ``peak_memory`` (bytes, of the process so far), ``fresh`` (True: done now; False: found finished,
verified and left alone) and, if it was done again because something was wrong with the file that was there,
``redone`` (what that was).
"""


class Task(Protocol):
    """One kind of work on partitions; a frozen dataclass that can be pickled."""

    def warm_up(self) -> None:
        """Once in each process, before the first partition: load kernels and tables, check that the machine fits."""

    def __call__(self, name: str) -> Record:
        """Do a partition, or verify that it is finished.

        The file appears in one move, and its record after it. Calling it again changes nothing; two processes that do
        the same partition write the same bytes.

        Raises:
            IkgradError: the partition cannot be done; the text says why.
            OSError: reading or writing failed.
        """
