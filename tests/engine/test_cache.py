"""Kernels are compiled once and kept; a folder that cannot be written is no obstacle."""

import logging
import os
import subprocess
import sys

from ikgrad.engine import cache

CALL = """
import numpy as np
from ikgrad import engine, load_robot
engine.fk(engine.pack(load_robot("kr210")), np.zeros((1, 6)))
"""


def _call(**environment):
    environment = {**os.environ, **environment}
    return subprocess.run([sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, check=True)


def test_first_compilation_says_so_and_the_second_process_is_silent(tmp_path):
    first, second = _call(NUMBA_CACHE_DIR=str(tmp_path)), _call(NUMBA_CACHE_DIR=str(tmp_path))
    assert "compiling" in first.stderr
    assert second.stderr == ""


def test_another_folder_is_taken_where_the_first_cannot_be_written(tmp_path, monkeypatch):
    blocked, user = tmp_path / "file", tmp_path / "user"
    blocked.touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked))
    monkeypatch.setenv("XDG_CACHE_HOME", str(user))
    assert cache.cache_folder.__wrapped__().is_relative_to(user)


def test_no_folder_at_all_leaves_the_kernels_uncached(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.touch()
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(blocked))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(blocked))
    assert cache.cache_folder.__wrapped__() is None
    monkeypatch.setattr(cache, "cache_folder", lambda: None)
    monkeypatch.setattr(cache, "_kernels", [])

    @cache.kernel
    def double(x):
        return 2 * x

    assert not cache.is_cached(double)
    assert cache.prepare(double)(3.0) == 6.0
    assert cache.is_cached(double)


def test_the_notice_goes_to_the_package_logger(caplog, monkeypatch):
    monkeypatch.setattr(cache, "_kernels", [])

    def never_compiled(x):
        return x

    with caplog.at_level(logging.WARNING, logger="ikgrad"):
        cache.prepare(cache.kernel(never_compiled))
    assert "never_compiled" in caplog.text
