"""The engine of this machine: worker processes, each fed name by name over a pipe of its own.

A worker that dies is replaced, and its replacement gets the same partition; after `STRIKES` deaths over one partition
the job ends with an error that names it. A driver that dies takes its workers along: their pipes end.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Generator, Mapping, Sequence
from typing import Any

from ikgrad.errors import ConfigError, DataError
from ikgrad.jobs.task import Record, Task

STRIKES = 3
GRACE = 10.0  # seconds for workers to remove what they had begun
START = "from ikgrad.jobs.worker import main; main()"


def run_local(task: Task, names: Sequence[str], *, workers: int, threads: int) -> Generator[Record, None, None]:
    """Do partitions with processes of this machine; a `KeyboardInterrupt` or an error stops all of them.

    Args:
        task: what is done.
        names: the partitions.
        workers: processes at most; never more than there are partitions.
        threads: threads of each.

    Yields:
        A record for each name, in order of completion.

    Raises:
        ConfigError: ``workers`` or ``threads`` is less than 1.
        IkgradError, OSError: what the task raised.
        DataError: three workers in a row died over a partition.
    """
    if workers < 1 or threads < 1:
        raise ConfigError(f"workers and threads must be at least 1, got {workers} and {threads}")
    team = _Team(task, names, threads)
    try:
        team.start(min(workers, len(names)))
        for _ in names:
            outcome = team.outcomes.get()
            if isinstance(outcome, BaseException):
                raise outcome
            yield outcome
    finally:
        team.stop()


class _DeathError(Exception):
    """A worker ended before it had answered."""

    def __init__(self, status: int | None):
        self.status = status


class _Worker:
    """The driver's end of one process."""

    def __init__(self, first: bytes, environment: Mapping[str, str]):
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            process_group=0 if os.name == "posix" else None,  # Ctrl-C is for the driver, which then ends the pipes
        )
        self._unsent = first

    def ask(self, name: str) -> Record | BaseException:
        """Send a name and wait for the record, or for what went wrong.

        Raises:
            _DeathError: there will be no answer.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(self._unsent + pickle.dumps(name))
            self._process.stdin.flush()
            self._unsent = b""
            kind, payload = "ready", None
            while kind == "ready":
                kind, payload = pickle.load(self._process.stdout)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):  # ValueError: `dismiss` has closed the pipe
            self.dismiss()
            raise _DeathError(self.end()) from None
        assert payload is not None
        return payload

    def dismiss(self) -> None:
        """End the pipe, which ends the process soon."""
        with contextlib.suppress(OSError):  # what is unsent is of no use to anybody
            assert self._process.stdin is not None
            self._process.stdin.close()

    def end(self) -> int:
        """Wait for a process that was dismissed, kill it if it does not leave, and return its exit status."""
        try:
            return self._process.wait(GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def close(self) -> None:
        """Let go of the pipe that nobody reads any more."""
        assert self._process.stdout is not None
        self._process.stdout.close()


class _Team:
    """Threads that each own a worker, hand it names and collect what comes back."""

    def __init__(self, task: Task, names: Sequence[str], threads: int):
        self.outcomes: queue.SimpleQueue[Record | BaseException] = queue.SimpleQueue()
        self._first = pickle.dumps((task, threads))
        self._environment = _environment(threads)
        self._names: queue.SimpleQueue[str] = queue.SimpleQueue()
        for name in names:
            self._names.put(name)
        self._lock, self._stopped = threading.Lock(), False
        self._workers: set[_Worker] = set()
        self._owners: list[threading.Thread] = []

    def start(self, workers: int) -> None:
        """Begin with so many."""
        for _ in range(workers):
            owner = threading.Thread(target=self._own, daemon=True)
            self._owners.append(owner)
            owner.start()

    def stop(self) -> None:
        """Let every worker go, and wait until it has gone."""
        with self._lock:
            self._stopped = True
            workers = list(self._workers)
        for worker in workers:
            worker.dismiss()
        for worker in workers:
            worker.end()
        for owner in self._owners:
            owner.join(GRACE)
        for worker in workers:
            worker.close()

    def _own(self) -> None:
        """Work through names with one worker after the other, until there are none or one fails."""
        worker: _Worker | None = None
        try:
            while not self._stopped:
                worker, outcome = self._do(worker, self._names.get_nowait())
                self.outcomes.put(outcome)
                if worker is None:
                    return
        except queue.Empty:
            if worker is not None:
                worker.dismiss()
        except BaseException as error:  # nobody else would notice that this thread ended
            self.outcomes.put(error)

    def _do(self, worker: _Worker | None, name: str) -> tuple[_Worker | None, Record | BaseException]:
        """One partition, with up to `STRIKES` workers; no worker is left after a failure."""
        status: Any = None
        for _ in range(STRIKES):
            try:
                worker = worker or self._hire()
                outcome = worker.ask(name)
                return (None if isinstance(outcome, BaseException) else worker), outcome
            except _DeathError as death:
                worker, status = None, death.status
        why = "killed, maybe for want of memory" if status == -9 else f"exit status {status}"
        return None, DataError(f"partition '{name}': {STRIKES} workers died over it, one after the other ({why})")

    def _hire(self) -> _Worker:
        with self._lock:
            if self._stopped:
                raise _DeathError(None)
            worker = _Worker(self._first, self._environment)
            self._workers.add(worker)
        return worker


def _environment(threads: int) -> dict[str, str]:
    """Workers find the packages that the driver found, and no library starts more threads than it should."""
    count = str(threads)
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path),
        "OMP_WAIT_POLICY": "passive",
        "OMP_NUM_THREADS": count,
        "MKL_NUM_THREADS": count,
    }
