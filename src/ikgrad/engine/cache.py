"""Compile a kernel once per machine: lazily, on disk, with a notice.

Numba's own cache looks at one source file a kernel; ours span several, so the folder's name carries a hash of all of
them, and editing one makes all kernels compile afresh. First choice is ``NUMBA_CACHE_DIR``, then the user's cache
folder, then a folder for temporary files; where none can be written, kernels compile once a process.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import caching, event

from ikgrad.garbage import no_collection

log = logging.getLogger("ikgrad")
_kernels: list[Any] = []


@functools.cache
def _fingerprint() -> str:
    """Hash of the engine's sources and Numba's version."""
    text = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        text.update(path.read_bytes())
    return text.hexdigest()[:16]


@functools.cache
def cache_folder() -> Path | None:
    """Where compiled kernels are kept; None if no folder can be written."""
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    owner = os.getuid() if hasattr(os, "getuid") else "user"
    roots = [os.environ.get("NUMBA_CACHE_DIR"), user, os.path.join(tempfile.gettempdir(), f"ikgrad-{owner}")]
    for root in filter(None, roots):
        folder = Path(root) / "ikgrad" / _fingerprint()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        if not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid():  # never load another user's code
            return folder
    return None


class _Locator(caching._CacheLocator):
    def __init__(self, py_func: Any) -> None:
        self._name = py_func.__module__.replace(".", "-")

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _Locator:
        return cls(py_func)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def get_source_stamp(self) -> str:
        return _fingerprint()

    def get_disambiguator(self) -> str:
        return self._name


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes: Any = [_Locator]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with no_collection():  # the first one imports what is left of Numba
            return super().load_overload(sig, target_context)


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator: compile a function of flat arrays at its first call, without the interpreter lock, and keep it."""
    compiled: Any = njit(nogil=True)(function)
    if cache_folder() is not None:
        compiled._cache = _Cache(function)
    _kernels.append(compiled)
    return compiled


def is_cached(compiled: Any) -> bool:
    """True if a kernel is in memory or on disk, so that calling it does not compile."""
    folder = cache_folder()
    if compiled.overloads:
        return True
    return folder is not None and any(folder.glob(f"{compiled._cache._impl.filename_base}*.nbc"))


class _WithoutCollection(event.Listener):
    """Garbage collection rests while Numba compiles: millions of objects live then, and none of them is garbage."""

    def __init__(self) -> None:
        self._depth, self._was_on = 0, False

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._was_on = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._was_on:
            gc.enable()


@functools.cache
def _rest_while_compiling() -> None:
    event.register("numba:compile", _WithoutCollection())


def prepare(compiled: Any) -> Any:
    """Say so before the first call that compiles; returns the kernel."""
    if not compiled.overloads and not is_cached(compiled):  # .signatures says the same, ten times slower
        log.warning("compiling the CPU kernel '%s' once for this machine ...", compiled.__name__)
        _rest_while_compiling()
    return compiled
