#!/usr/bin/env bash
# Install if needed, then lint, types and tests. Further arguments go to pytest: bash scripts/test.sh -m slow
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash scripts/setup.sh
export PATH="$PWD/.venv/bin:$PATH" OMP_WAIT_POLICY=passive
ruff check .
ruff format --check .
mypy
pytest -n 2 "$@"
