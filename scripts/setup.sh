#!/usr/bin/env bash
# Make .venv and install the project into it, editable, with everything that the tests need. Quick when up to date.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
stamp=".venv/.installed-$(cat pyproject.toml constraints/cpu.txt | sha256sum | cut -c1-16)"
if [ -e "$stamp" ]; then
  exit 0
fi
if [ ! -x .venv/bin/python ]; then
  python3 -m venv .venv
fi
echo "installing ikgrad into .venv (once; about 1.5 GB on disk, most of it torch) ..." >&2
# torch goes first and alone, so that nothing else chooses a build with CUDA
.venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints/cpu.txt torch
.venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints/cpu.txt --editable '.[dev]'
rm -f .venv/.installed-*
touch "$stamp"
