"""One thread for all work behind a page, in which only the latest of several like requests is done.

A page sends a dragged target a hundred times a second, from several threads. The compiled kernels are called from one
thread only, and a target that has been overtaken by the next one is not worth solving.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

Task = Callable[[], object]
_log = logging.getLogger(__name__)


class _Waiting(NamedTuple):
    due: float  # on time.monotonic's clock
    task: Task


class Worker:
    """Runs the task that is due first; a later task of the same key replaces the one that waits.

    Example:
        >>> worker, done = Worker(), []
        >>> worker.submit("count", lambda: done.append(1))
        >>> worker.wait()
        True
        >>> worker.stop()
        >>> done
        [1]
    """

    def __init__(self) -> None:
        self._waiting: dict[str, _Waiting] = {}
        self._change = threading.Condition()
        self._busy = self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="ikgrad-view")
        self._thread.start()

    def submit(self, key: str, task: Task, *, delay: float = 0.0) -> None:
        """Do this after so many seconds, instead of what waits under the same key."""
        with self._change:
            self._waiting[key] = _Waiting(time.monotonic() + delay, task)
            self._change.notify_all()

    def drop(self, key: str) -> None:
        """Forget what waits under a key."""
        with self._change:
            self._waiting.pop(key, None)
            self._change.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Until nothing is left to do; False if that took longer than ``timeout`` [s]."""
        with self._change:
            return self._change.wait_for(lambda: not self._waiting and not self._busy, timeout)

    def stop(self) -> None:
        """Finish the present task, forget the others."""
        with self._change:
            self._stopped = True
            self._waiting.clear()
            self._change.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        while (task := self._next()) is not None:
            try:
                task()
            except Exception:  # one failed update must not freeze the page
                _log.exception("an update of the page failed")
            with self._change:
                self._busy = False
                self._change.notify_all()

    def _next(self) -> Task | None:
        """Sleep until a task is due, and take it; None at the end."""
        with self._change:
            while not self._stopped:
                key = min(self._waiting, key=lambda key: self._waiting[key].due, default=None)
                left = None if key is None else self._waiting[key].due - time.monotonic()
                if key is not None and left is not None and left <= 0:
                    self._busy = True
                    return self._waiting.pop(key).task
                self._change.wait(left)
        return None


__all__ = ["Worker"]
