"""Make the inverters that come with the package: train each by the shipped command, and store it with its report.

    python scripts/make_inverters.py [--robots panda ur5e ...] [--minutes 15] [--seed 0] [--runs DIR] [--redo]

Every robot gets a run folder under ``--runs`` and, when that is finished, ``src/ikgrad/_data/inverters/<robot>`` with
model.safetensors, config.json, report.json and report.png. A robot whose inverter in the package
is the one of its finished run is skipped; a training that was stopped goes on. One process, so that trainings do not
share the cores; the number of threads is torch's own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from PIL import Image

import ikgrad as ik
from ikgrad.networks.places import CONFIG, READY_MADE, WEIGHTS
from ikgrad.resources import builtin_names

PACKAGE = Path(ik.__file__).parent / "_data" / READY_MADE
REPORTS = ("report.json", "report.png")


def main() -> None:
    """Robot by robot, one line each."""
    options = _options()
    for name in options.robots:
        run, home = options.runs / name, PACKAGE / name
        done = all((home / report).is_file() for report in REPORTS)
        if done and not options.redo and _same(run / "model" / WEIGHTS, home / WEIGHTS):
            print(f"{name}: done already")
            continue
        if options.redo or not (run / "model" / CONFIG).is_file():
            train(name, run, options)
        evaluate(run)
        store(run, home)
        size = sum(path.stat().st_size for path in home.iterdir())
        print(f"{name}: {', '.join(sorted(path.name for path in home.iterdir()))}; {size / 1e3:.0f} kB", flush=True)


def train(name: str, run: Path, options: argparse.Namespace) -> None:
    """One run folder; a run that was stopped goes on."""
    run.parent.mkdir(parents=True, exist_ok=True)
    again = ["--force"] if options.redo else ["--resume"] if run.is_dir() else []
    settings = ["--model", "unrolled", "--minutes", str(options.minutes), "--seed", str(options.seed)]
    _ikgrad("train", "--robot", name, *settings, "--out", str(run), *again)


def evaluate(run: Path) -> None:
    """The reports, in a folder of the run."""
    _ikgrad("evaluate", str(run), "--out", str(run / "report"), "--force")


def store(run: Path, home: Path) -> None:
    """The inverter and its reports, in the package; it must load for the robot of its name."""
    ik.load_inverter(run, robot=ik.load_robot(home.name)).save(home, force=True)
    report = {**json.loads((run / "report" / "evaluation.json").read_text()), "inverter": home.name}
    (home / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    page = Image.open(run / "report" / "evaluation.png").convert("RGB")
    few = page.quantize(255, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)  # a quarter of the bytes
    few.save(home / "report.png", optimize=True)


def _same(ours: Path, theirs: Path) -> bool:
    return ours.is_file() and theirs.is_file() and ours.read_bytes() == theirs.read_bytes()


def _ikgrad(*arguments: str) -> None:
    """The shipped command, as a user calls it."""
    print("ikgrad", *arguments, flush=True)
    subprocess.run([sys.executable, "-m", "ikgrad", *arguments], check=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", choices=builtin_names("urdf"), default=builtin_names("urdf"))
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=Path, default=Path("runs/inverters"))
    parser.add_argument("--redo", action="store_true", help="train anew what is there")
    return parser.parse_args()


if __name__ == "__main__":
    main()
