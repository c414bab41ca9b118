"""Python in a process of its own: how long it ran and how much memory it held at most."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ikgrad.errors import ConfigError

# A child's greatest resident memory counts from before its `exec`, when it still is its parent: started from here it
# would be at least ours, with a million poses in it. So a small process stands between, starts it and looks on.
_WATCH = """
import json, subprocess, sys, time
begin = time.perf_counter()
done = subprocess.run(sys.argv[1:], capture_output=True, encoding="utf-8", errors="replace")
seconds = time.perf_counter() - begin
try:
    import resource
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
except ImportError:
    peak = float("nan")
json.dump([done.returncode, done.stdout, done.stderr, seconds, peak / 1e6], sys.stdout)
"""


class Ended(NamedTuple):
    """What a process left."""

    output: str
    errors: str
    seconds: float
    peak: float  # greatest resident memory [MB]; NaN where the system does not tell


def run_python(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Ended:
    """Run this Python with some arguments and more environment variables.

    Raises:
        ConfigError: it failed; the message ends with its last line.

    Example:
        >>> ended = run_python(["-c", "print(6 * 7)"])
        >>> ended.output.strip(), ended.peak < 100
        ('42', True)
    """
    variables = {**os.environ, "OMP_WAIT_POLICY": "passive", **(environment or {})}
    command = [sys.executable, "-I", "-S", "-c", _WATCH, sys.executable, *arguments]
    watch = subprocess.run(command, stdout=subprocess.PIPE, env=variables, check=True)
    status, *ended = json.loads(watch.stdout)
    if status != 0:
        lines = ended[1].strip().splitlines()
        raise ConfigError(f"a process of the benchmark failed: {lines[-1] if lines else status}")
    return Ended(*ended)
