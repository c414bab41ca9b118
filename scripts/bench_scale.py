"""Measure bulk inverse kinematics by `ikgrad sample` and `ikgrad solve` over partitions, and plan what is beyond.

    python scripts/bench_scale.py [--counts 100000 1000000 10000000 30000000] [--rounds 3] [--json FILE] [--fresh]
    python scripts/bench_scale.py --overhead       # partitions without work: local, Ray actors, Ray Data
    python scripts/bench_scale.py --many 10000     # that many tiny partitions

    ... --write docs/scale.md                      # also put the tables into the page

Every run is a command in a fresh process, engines take turns, and times are medians over the rounds (a single round
from 10 million poses on). Peak memory is the greatest of any process of the command (Linux). Outputs of all engines are
compared by the checksums in their manifests, which the last run of each verifies against the files (`--resume`). Runs
that are finished are kept in FILE, so that the same command goes on where it stopped; ``--fresh`` begins again.

The model behind the plan (scripts/scale_model.py) is fitted to one worker at the smallest count and the largest but
one, and checked against all other runs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import scale_model
import scale_overhead

from ikgrad import __version__

SOLVES = {
    "local, 1 worker": ["--workers", "1"],
    "local, 2 workers": ["--workers", "2"],
    "ray, 2 workers": ["--workers", "2", "--engine", "ray"],
}
WORKERS = {name: int(options[1]) for name, options in SOLVES.items()}
ONE, TWO, RAY = SOLVES
Result = dict[str, Any]


# ---------------------------------------------------------------- runs


def command(*arguments: str) -> Result:
    """An ``ikgrad`` command in a process of its own: its JSON, wall time and peak memory."""
    begin = time.perf_counter()
    words = [sys.executable, "-m", "ikgrad", *arguments, "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    peak = 0.0
    while process.poll() is None:
        peak = max([peak, *map(greatest_memory, family(process.pid))])
        time.sleep(0.2)
    seconds = time.perf_counter() - begin
    assert process.stdout is not None
    assert process.stderr is not None
    if process.returncode:
        raise SystemExit(f"{' '.join(words)} ended with {process.returncode}:\n{process.stderr.read()}")
    return {"seconds": seconds, "peak_mb": peak / 1e6, "said": json.loads(process.stdout.read())}


def family(pid: int) -> list[int]:
    """A process and all below it; itself alone where the system does not tell."""
    found = [pid]
    for parent in found:
        for children in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += [int(child) for child in children.read_text().split()]
            except OSError:  # it has ended
                continue
    return found


def greatest_memory(pid: int) -> float:
    """Peak resident bytes of a process so far; NaN if it has ended or the system does not tell."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return float("nan")
    return next((float(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), float("nan"))


def manifest(folder: Path) -> dict[str, Any]:
    """Of a finished folder."""
    return json.loads((folder / "_manifest.json").read_text())


class Runs:
    """What was run, kept in a file."""

    def __init__(self, path: Path, *, fresh: bool):
        self._path = path
        self.done: dict[str, Result] = json.loads(path.read_text()) if path.exists() and not fresh else {}

    def once(self, key: str, run: Callable[[], Result]) -> Result:
        """The result under this key, run now if it is not there."""
        if key not in self.done:
            print(f"{key} ...", file=sys.stderr, flush=True)
            self.keep(key, run())
        return self.done[key]

    def keep(self, key: str, result: Result) -> None:
        """Write it down."""
        self.done[key] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(self.done, indent=1))
        part.replace(self._path)


def run_count(runs: Runs, args: argparse.Namespace, count: int) -> None:
    """Sample so many poses, solve them by every engine, in turns."""
    rounds = args.rounds if count < 10_000_000 else 1
    keys = [(turn, name) for turn in range(rounds) for name in list(SOLVES)[:: -1 if turn % 2 else 1]]
    if all(f"{count} {name} {turn}" in runs.done for turn, name in keys):
        return
    folder = Path(args.work) / str(count)
    poses = folder / "poses"
    if f"{count} sample" not in runs.done or not (poses / "_manifest.json").exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        rows = str(min(args.rows, max(1, count // 8)))  # enough partitions to share out
        sample = ["sample", "--robot", args.robot, "--count", str(count), "--partition-rows", rows]
        print(f"{count} sample ...", file=sys.stderr, flush=True)
        result = command(*sample, "-o", str(poses))
        runs.keep(f"{count} sample", result | {"totals": manifest(poses)["totals"]})
    for turn, name in keys:
        runs.once(f"{count} {name} {turn}", lambda name=name, turn=turn: solve(args, folder, name, turn == rounds - 1))
    shutil.rmtree(folder)


def solve(args: argparse.Namespace, folder: Path, name: str, verify: bool) -> Result:
    """One run; the folder is removed after its checksums were kept."""
    output = folder / name.replace(", ", "-").replace(" ", "-")
    shutil.rmtree(output, ignore_errors=True)
    words = ["solve", "--robot", args.robot, str(folder / "poses"), "-o", str(output), *SOLVES[name]]
    result = command(*words)
    document = manifest(output)
    if verify:
        again = command(*words, "--resume")
        assert again["said"]["done"] == 0, again["said"]
        result["verify_seconds"] = again["seconds"]
    sums = {part: given["sha256"] for part, given in document["partitions"].items()}
    shutil.rmtree(output)
    return result | {"totals": document["totals"], "sha256": sums}


# ---------------------------------------------------------------- what is printed


def results(runs: Runs, count: int, name: str) -> list[Result]:
    """All rounds of one cell."""
    return [result for key, result in runs.done.items() if key.startswith(f"{count} {name} ")]


def seconds(runs: Runs, count: int, name: str) -> float:
    """Wall time of one cell."""
    return median(result["seconds"] for result in results(runs, count, name))


def measured_table(runs: Runs, counts: list[int]) -> str:
    """Time and memory."""
    head = ["poses", "engine", "seconds", "poses/s a core", "MB of the greatest process", "verified in"]
    table = [head, ["---"] * len(head)]
    for count in counts:
        for name, workers in WORKERS.items():
            took, each = seconds(runs, count, name), results(runs, count, name)
            peak = max(result["peak_mb"] for result in each)
            verify = each[-1]["verify_seconds"]
            rate = count / took / workers
            table.append([f"{count:,}", name, f"{took:.1f}", f"{rate:,.0f}", f"{peak:,.0f}", f"{verify:.1f} s"])
    return markdown(table)


def ratio_table(runs: Runs, counts: list[int]) -> str:
    """Engines against one another, and their outputs compared."""
    table = [["poses", "ray / local", "one worker / two", "outputs", "bytes a pose in", "out"], ["---"] * 6]
    for count in counts:
        one, two, ray = (seconds(runs, count, name) for name in SOLVES)
        sums = [result["sha256"] for name in SOLVES for result in results(runs, count, name)]
        same = f"{len(sums)} x {len(sums[0])} files, " + (
            "all the same" if all(x == sums[0] for x in sums) else "DIFFERENT"
        )
        sizes = [f"{size:.1f}" for size in bytes_of_a_pose(runs, count)]
        table.append([f"{count:,}", f"{ray / two:.2f}", f"{one / two:.2f}", same, *sizes])
    return markdown(table)


def bytes_of_a_pose(runs: Runs, count: int) -> tuple[float, float]:
    """Poses and joints."""
    totals = runs.done[f"{count} sample"]["totals"], results(runs, count, ONE)[0]["totals"]
    return totals[0]["bytes"] / count, totals[1]["bytes"] / count


def base(counts: list[int]) -> list[int]:
    """The smallest count and the largest but one, so that the largest is a prediction."""
    return [counts[0], counts[-2] if len(counts) > 2 else counts[-1]]


def fitted(runs: Runs, counts: list[int]) -> scale_model.Cost:
    """From one worker at two of the counts."""
    bytes_in, bytes_out = bytes_of_a_pose(runs, counts[-1])
    two = [(float(count), seconds(runs, count, ONE)) for count in base(counts)]
    return scale_model.fit(two, bytes_in=bytes_in, bytes_out=bytes_out)


def check_table(runs: Runs, counts: list[int], cost: scale_model.Cost) -> str:
    """The model against the runs that it was not made of."""
    table = [["poses", "engine", "predicted [s]", "measured [s]", "measured / predicted"], ["---"] * 5]
    for count in counts:
        for name, workers in WORKERS.items():
            if name == ONE and count in base(counts):
                continue  # the model is made of these
            says, took = cost.seconds(count, workers), seconds(runs, count, name)
            table.append([f"{count:,}", name, f"{says:.1f}", f"{took:.1f}", f"{took / says:.2f}"])
    return markdown(table)


def markdown(table: list[list[str]]) -> str:
    """Lines of a table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in table)


# ---------------------------------------------------------------- many partitions


def run_many(runs: Runs, args: argparse.Namespace) -> str:
    """Tiny partitions: what each costs the driver, the folder and the manifest; nearly no poses."""
    parts, rows = args.many, 10
    folder = Path(args.work) / f"many-{parts}"
    folder.mkdir(parents=True, exist_ok=True)
    table = [["command", "seconds", "ms a partition", "MB of the greatest process"], ["---"] * 4]
    poses, output = folder / "poses", folder / "joints"
    commands = {
        "sample": ["sample", "--count", str(parts * rows), "--partition-rows", str(rows), "-o", str(poses)],
        "solve": ["solve", str(poses), "-o", str(output)],
        "solve --resume, all finished": ["solve", str(poses), "-o", str(output), "--resume"],
    }
    for name, words in commands.items():
        result = runs.once(f"many {parts} {name}", lambda words=words: command(*words, "--robot", args.robot))
        took = result["seconds"]
        table.append([name, f"{took:.1f}", f"{1e3 * took / parts:.2f}", f"{result['peak_mb']:,.0f}"])
    sizes = runs.once(f"many {parts} sizes", lambda: sizes_of(output))
    shutil.rmtree(folder, ignore_errors=True)
    text = ", ".join(f"{name} {value / parts:,.0f}" for name, value in sizes.items())
    return f"{parts:,} partitions of {rows} poses\n\n{markdown(table)}\n\nBytes a partition: {text}"


def sizes_of(output: Path) -> Result:
    """Bytes of what says what the partitions are."""
    return {
        "manifest": (output / "_manifest.json").stat().st_size,
        "job": (output / "_job.json").stat().st_size,
        "records": sum(path.stat().st_size for path in (output / "_records").iterdir()),
    }


# ---------------------------------------------------------------- the command


def main() -> None:
    """Run what is asked for, print it, put it into the page."""
    args = _options()
    runs = Runs(Path(args.json), fresh=args.fresh)
    about = f"ikgrad {__version__}, Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores"
    print(about)
    for name, text in blocks(runs, args).items():
        print(f"\n{text}")
        if args.write:
            put(Path(args.write), name, text)


def blocks(runs: Runs, args: argparse.Namespace) -> dict[str, str]:
    """What is printed, by its name in the page."""
    if args.overhead:
        return {"overhead": scale_overhead.table([60, 600], 0.02, args.rounds)}
    if args.many:
        return {"many": run_many(runs, args)}
    counts = sorted(args.counts)
    for count in counts:
        run_count(runs, args, count)
    found = {"runs": measured_table(runs, counts), "engines": ratio_table(runs, counts)}
    if len(counts) > 1:
        cost = fitted(runs, counts)
        found["cost"] = (
            f"start {cost.start:.2f} s, {cost.pose * 1e6:.2f} core microseconds, "
            f"{cost.bytes_in:.1f} bytes in and {cost.bytes_out:.1f} bytes out a pose"
        )
        found["check"] = check_table(runs, counts, cost)
        found["plan"] = scale_model.table(cost, args.plan, scale_model.assumptions(args))
    return found


def put(page: Path, name: str, text: str) -> None:
    """Replace what stands in the page between the marks of this name."""
    before, mark, rest = page.read_text().partition(f"<!-- {name} -->\n")
    _, end, after = rest.partition(f"<!-- end of {name} -->")
    if not mark or not end:
        raise SystemExit(f"{page} has no place for '{name}'")
    page.write_text(f"{before}{mark}\n{text}\n\n{end}{after}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    counts = [100_000, 1_000_000, 10_000_000, 30_000_000]
    parser.add_argument("--counts", type=int, nargs="+", default=counts, metavar="N")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--overhead", action="store_true")
    parser.add_argument("--many", type=int, metavar="PARTITIONS")
    parser.add_argument("--work", default="out/scale", help="folder for the partitions, which are removed at the end")
    parser.add_argument("--json", default="out/scale.json", metavar="FILE", help="what was run, to go on from")
    parser.add_argument("--write", metavar="PAGE", help="put the tables into this page")
    parser.add_argument("--fresh", action="store_true", help="forget what FILE has")
    scale_model.add_assumptions(parser)
    return parser.parse_args()


if __name__ == "__main__":
    main()
