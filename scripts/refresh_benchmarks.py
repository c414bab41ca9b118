"""Run the commands of docs/benchmarks.md again and put what they print in place of what stands there.

    python scripts/refresh_benchmarks.py [PATTERN]

A block that begins with ``$ ikgrad bench ...`` is one command and its output. With a pattern (a regex) only
the matching commands run. The peers must be installed: ``pip install '.[bench]'``. The prose is not touched.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
BLOCK = re.compile(r"```\n\$ (ikgrad bench [^\n]*)\n.*?```", re.DOTALL)
IKGRAD = Path(sys.executable).with_name("ikgrad")


def refreshed(match: re.Match[str]) -> str:
    """The block with what its command prints now."""
    command = match[1]
    if len(sys.argv) > 1 and not re.search(sys.argv[1], command):
        return match[0]
    begin = time.perf_counter()
    arguments = [str(IKGRAD), *shlex.split(command)[1:]]
    done = subprocess.run(arguments, capture_output=True, text=True, env={**os.environ, "COLUMNS": "160"})
    print(f"{time.perf_counter() - begin:6.0f} s  {command}", flush=True)
    if done.returncode != 0:
        print(done.stderr, file=sys.stderr)
        return match[0]
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    return f"```\n$ {command}\n" + "\n".join(lines).strip("\n") + "\n```"


def main() -> None:
    """Refresh block by block; an interrupt keeps what is done."""
    text = PAGE.read_text(encoding="utf-8")
    for match in list(BLOCK.finditer(text)):
        text = text.replace(match[0], refreshed(match))
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
