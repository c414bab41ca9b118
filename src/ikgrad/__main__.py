"""``python -m ikgrad``: the command line, also for ``torchrun -m ikgrad train``."""

from __future__ import annotations

import sys

from ikgrad.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
