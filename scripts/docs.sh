#!/usr/bin/env bash
# Install if needed, and build the documentation into out/docs; warnings are errors. Further arguments go to mkdocs build.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash scripts/setup.sh
export NO_MKDOCS_2_WARNING=1  # the theme's notice of its successor
if ! .venv/bin/python -c "import material, mkdocstrings_handlers.python" 2> /dev/null; then
  .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints/cpu.txt --editable '.[dev,docs]'
fi
.venv/bin/python -m mkdocs build --strict "$@"
echo "open out/docs/index.html"
