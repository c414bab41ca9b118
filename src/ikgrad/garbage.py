"""Python's garbage collector, put to rest where it would look at millions of objects and find none to free."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """No garbage collection in the block: large imports and the compiler make objects that stay.

    A quarter of the time from ``import torch`` to the first solution went into looking at them. Blocks may be nested
    and overlap in several threads; the collector is never left off when it was on before the first of them.

    Example:
        >>> with no_collection():
        ...     gc.isenabled()
        False
        >>> gc.isenabled()
        True
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
