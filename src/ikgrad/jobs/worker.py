"""A process of `ikgrad.jobs.local`: names of partitions in, records out, until the pipe from the driver ends."""

from __future__ import annotations

import _thread
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from functools import partial
from typing import IO, Any

GRACE = 5.0  # seconds to leave properly once the driver is gone


def main() -> None:
    """Talk to the driver over stdin and stdout; what else is printed goes to stderr.

    The first message is (task, threads), each later one a name. The answers are ("ready", None), ("done", record) and
    ("error", exception).
    """
    conversation = _Conversation(sys.stdin.buffer, os.fdopen(os.dup(1), "wb"))
    os.dup2(2, 1)
    try:
        conversation.hold()
    except (KeyboardInterrupt, EOFError, BrokenPipeError):
        pass  # the driver is gone or wants no more; what was begun is removed by now
    finally:
        os._exit(0)  # no finalisers: nobody waits for anything here any more


class _Conversation:
    """The worker's end of the pipe."""

    def __init__(self, inbox: IO[bytes], outbox: IO[bytes]):
        self._inbox, self._outbox = inbox, outbox
        self._names: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._working = False
        signal.signal(signal.SIGINT, self._interrupt)

    def hold(self) -> None:
        """Answer until there is no more to do, or something failed."""
        task, threads = pickle.load(self._inbox)
        threading.Thread(target=self._listen, daemon=True).start()
        _set_threads(threads)
        if self._answer("ready", task.warm_up):
            while (name := self._names.get()) is not None and self._answer("done", partial(task, name)):
                pass

    def _listen(self) -> None:
        """Pass names on; the end of the pipe stops the work, whatever it is doing."""
        try:
            while True:
                self._names.put(pickle.load(self._inbox))
        except (EOFError, OSError):
            self._names.put(None)
        _thread.interrupt_main()
        threading.Event().wait(GRACE)
        os._exit(1)

    def _interrupt(self, *_: object) -> None:
        if self._working:
            raise KeyboardInterrupt

    def _answer(self, kind: str, work: Callable[[], Any]) -> bool:
        """Do it and report; False if it failed."""
        self._working = True
        try:
            message = (kind, work())
        except Exception as error:  # whatever it is, the driver has to know
            message = ("error", portable(error))
        self._working = False
        pickle.dump(message, self._outbox)
        self._outbox.flush()
        return message[0] == kind


def _set_threads(threads: int) -> None:
    """The environment says it to what is imported later."""
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(threads)


def portable(error: Exception) -> Exception:
    """The same exception if it survives pickling, else one with its text; a bug brings its traceback along.

    Example:
        >>> from ikgrad.errors import DataError
        >>> portable(DataError("a.parquet: is damaged"))
        DataError('a.parquet: is damaged')
    """
    from ikgrad.errors import DataError, IkgradError

    if not isinstance(error, IkgradError | OSError | MemoryError):
        return RuntimeError("".join(traceback.format_exception(error)).rstrip())
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # any way to fail means the same
        return DataError(str(error))
    return error
