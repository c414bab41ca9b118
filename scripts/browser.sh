#!/usr/bin/env bash
# Get playwright and a Chromium if they are missing, and drive the page of `ikgrad view` with them: the browser tests.
# Further arguments go to pytest. IKGRAD_CHROMIUM names a Chromium that is not on PATH.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash scripts/setup.sh
if ! .venv/bin/python -c "import playwright" 2> /dev/null; then
  .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints/cpu.txt --editable '.[dev,browser]'
fi
has_chromium() { (cd scripts && ../.venv/bin/python -c "import headless, sys; sys.exit(headless.find_chromium() is None)"); }
if ! has_chromium; then
  if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null; then
    echo "installing Debian's chromium (apt-get) ..." >&2
    apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium > /dev/null
  else
    echo "no Chromium found: install one (Debian: apt-get install chromium) or set IKGRAD_CHROMIUM to its path" >&2
    exit 2
  fi
fi
export OMP_WAIT_POLICY=passive
.venv/bin/python -m pytest -q tests/view/test_browser.py "$@"
