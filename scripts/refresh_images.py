"""Draw the reference pictures in tests/images anew: ``python scripts/refresh_images.py [NAME ...]``.

Prints which of them changed, and by how much; those within the tolerance of the test stay as they are.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import pictures


def main() -> None:
    """Compare and replace."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures to draw (all)")
    parser.add_argument("--all", action="store_true", help="also replace those within the tolerance")
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(pictures.CASES))
    if unknown:
        parser.error(f"unknown {', '.join(unknown)} (known: {', '.join(pictures.CASES)})")
    for name in args.names or pictures.CASES:
        print(f"{name}: {refresh(name, replace_all=args.all)}", flush=True)
    for path in sorted(set(pictures.FOLDER.glob("*.png")) - {pictures.path_of(name) for name in pictures.CASES}):
        path.unlink()
        print(f"{path.stem}: removed, no such case")
    total = sum(path.stat().st_size for path in pictures.FOLDER.glob("*.png"))
    print(f"{len(pictures.CASES)} pictures, {total / 1000:.0f} kB")


def refresh(name: str, *, replace_all: bool) -> str:
    """Draw one picture; what became of it, in words."""
    path, now = pictures.path_of(name), pictures.draw(name)
    if not path.exists():
        pictures.write(now, path)
        return "new"
    found = pictures.difference(now, pictures.read(path))
    if found <= pictures.TOLERANCE and not replace_all:
        return f"as it was (difference {found:.1f})"
    pictures.write(now, path)
    return f"replaced (difference {found:.1f})"


if __name__ == "__main__":
    main()
