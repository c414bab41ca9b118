"""Draw the pictures of docs/figures.md: ``python scripts/draw_figures.py [summary workspace learning arm]``."""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from pathlib import Path

import numpy as np

from ikgrad.cli.main import main as ikgrad

IMAGES = Path(__file__).parents[1] / "docs" / "images"
FAR = 1.25  # every seventh pose is moved away from the base by this factor


def run(*words: str) -> None:
    """One command, or an error."""
    with contextlib.redirect_stdout(io.StringIO()):
        if ikgrad(list(words)) != 0:
            raise SystemExit(f"ikgrad {' '.join(words)} failed")


def draw(kind: str, *words: str) -> None:
    """One picture of the page."""
    path = IMAGES / f"plot_{kind}.png"
    run("plot", *words, "-o", str(path), "--dpi", "90", "--force")
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB", flush=True)


def solved(folder: Path) -> str:
    """A joint file, some of whose poses are out of reach."""
    poses, joints = folder / "poses.csv", folder / "joints.csv"
    if not joints.exists():
        run("sample", "--robot", "panda", "--count", "5000", "--seed", "0", "-o", str(poses))
        rows = np.loadtxt(poses, delimiter=",", skiprows=1)
        rows[::7, :2] *= FAR
        np.savetxt(poses, rows, delimiter=",", header=poses.read_text().splitlines()[0], comments="")
        run("solve", "--robot", "panda", str(poses), "-o", str(joints))
    return str(joints)


def trained(folder: Path) -> list[str]:
    """Two runs of three members each."""
    runs = []
    for rate in ("0.016", "0.002"):
        runs.append(str(folder / f"lr{rate}"))
        run("train", "--robot", "panda", "--steps", "120", "--members", "3", "--lr", rate, "--out", runs[-1])
    return runs


def main() -> None:
    """Draw what was asked for."""
    pictures = {
        "summary": lambda folder: draw("summary", solved(folder)),
        "workspace": lambda folder: draw("workspace", solved(folder), "--robot", "panda", "--kind", "workspace"),
        "learning": lambda folder: draw("learning", *trained(folder)),
        "arm": lambda _: draw("arm", "panda", "--q", "0.3,0.3,0,-1.9,0,2.2,0.8"),
    }
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(pictures)} (all)")
    names = parser.parse_args().names or list(pictures)
    if unknown := sorted(set(names) - set(pictures)):
        parser.error(f"unknown {', '.join(unknown)} (known: {', '.join(pictures)})")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            pictures[name](Path(folder))


if __name__ == "__main__":
    main()
