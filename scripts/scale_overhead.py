"""What an engine adds to the work: partitions that only sleep, by local processes, Ray actors and Ray Data.

Run by ``python scripts/bench_scale.py --overhead``; a module of its own, since workers import the task by name.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from ikgrad.jobs import Record, run_local

ENGINES = {"local": "local processes", "actors": "Ray, plain actors", "data": "Ray Data, `map_batches`"}
WORKERS = 2


@dataclass(frozen=True)
class Sleeping:
    """No work, for a while."""

    seconds: float

    def warm_up(self) -> None:
        """Nothing to load."""

    def __call__(self, name: str) -> Record:
        """Wait."""
        time.sleep(self.seconds)
        return {"name": name}


def by_ray(task: Sleeping, names: Sequence[str], address: str | None = None) -> Iterator[Record]:
    """The engine of the package."""
    from ikgrad.jobs.ray_engine import run_ray

    return run_ray(task, names, workers=WORKERS, threads=1, address=address)


def by_ray_data(task: Sleeping, names: Sequence[str]) -> Iterator[Record]:
    """What it might be instead; the cluster is started in the same way."""
    from ikgrad.jobs import ray_engine

    class Worker:
        def __call__(self, batch: dict) -> dict:
            return {"record": [json.dumps(task(name)) for name in batch["item"]]}

    with ray_engine._cluster(None, cores=WORKERS) as ray:
        import ray.data

        ray.data.DataContext.get_current().enable_progress_bars = False
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        blocks = ray.data.from_items(names, override_num_blocks=len(names))  # else records come many at a time
        pool = ray.data.ActorPoolStrategy(size=WORKERS)
        for row in blocks.map_batches(Worker, batch_size=1, compute=pool, num_cpus=1).iter_rows():
            yield json.loads(row["record"])


def once(engine: str, count: int, seconds: float) -> None:
    """One engine in this process; prints the seconds that it took from here."""
    begin = time.perf_counter()
    task, names = Sleeping(seconds), [f"part-{k}" for k in range(count)]
    if engine == "local":
        records = run_local(task, names, workers=WORKERS, threads=1)
    else:
        records = (by_ray if engine == "actors" else by_ray_data)(task, names)
    assert sorted(record["name"] for record in records) == sorted(names)
    print(time.perf_counter() - begin)


def table(counts: Sequence[int], seconds: float, rounds: int) -> str:
    """Seconds beyond ``count * seconds / workers``, the median of fresh processes in turns; Markdown."""
    took: dict[tuple[str, int], list[float]] = {}
    for turn in range(rounds):
        for engine in list(ENGINES)[:: -1 if turn % 2 else 1]:
            for count in counts:
                code = f"import scale_overhead as s; s.once({engine!r}, {count}, {seconds})"
                place = str(Path(__file__).parent)
                done = subprocess.run([sys.executable, "-c", code], cwd=place, capture_output=True, text=True)
                if done.returncode:
                    raise SystemExit(done.stderr)
                took.setdefault((engine, count), []).append(float(done.stdout.split()[-1]))
    lines = [["engine", *[f"{count:,} partitions" for count in counts]], ["---"] * (len(counts) + 1)]
    for engine, name in ENGINES.items():
        beyond = [median(took[engine, count]) - count * seconds / WORKERS for count in counts]
        lines.append([name, *[f"{value:.1f} s" for value in beyond]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
