"""Rows in chunks over a few threads: kernels run without the interpreter lock, any thread may call, fork is safe."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Lock

_pool: ThreadPoolExecutor | None = None
_size = 0
_lock = Lock()


def _forget_pool() -> None:
    """After a fork the child has none of the parent's threads: start afresh."""
    global _pool, _size, _lock
    _pool, _size, _lock = None, 0, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


def _helpers(count: int) -> ThreadPoolExecutor:
    global _pool, _size
    with _lock:
        if _pool is None or _size < count:
            # a smaller pool before it is only dropped: another thread may be about to use it, and its threads end
            # when nobody holds it any more
            _pool, _size = ThreadPoolExecutor(count, thread_name_prefix="ikgrad"), count
        return _pool


def for_chunks(work: Callable[[int, int], None], rows: int, chunk: int, threads: int) -> None:
    """Call ``work(first, last)`` for all chunks of the rows.

    Threads take the next chunk when they are done with one, so hard rows do not hold up the others. The caller's
    thread works too; an interrupt there stops the helpers at their next chunk.

    Args:
        work: does rows first..last; lets go of the interpreter lock.
        rows: how many rows there are.
        chunk: rows a call.
        threads: threads at work, the caller's included.
    """
    if rows <= chunk or threads <= 1:
        for first in range(0, rows, chunk):
            work(first, min(first + chunk, rows))
        return
    numbers, stop = itertools.count(), Event()

    def loop() -> None:
        while not stop.is_set():
            first = next(numbers) * chunk
            if first >= rows:
                return
            work(first, min(first + chunk, rows))

    count = min(threads, -(-rows // chunk)) - 1
    pool = _helpers(count)
    futures = [pool.submit(loop) for _ in range(count)]
    try:
        loop()
    except BaseException:
        stop.set()
        raise
    finally:
        for future in futures:
            if not future.cancel():  # a helper that has not begun is not needed any more
                future.result()
