"""Commands over folders of partitions: their options, the engine, progress, and what is said when they are stopped."""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.parsing import count
from ikgrad.cli.terminal import Interrupted, Progress, duration
from ikgrad.errors import ConfigError, DataError, describe
from ikgrad.extras import check

if TYPE_CHECKING:
    from ikgrad.jobs.folder import Job, JobFolder
    from ikgrad.jobs.partitions import Shard
    from ikgrad.jobs.task import Record, Task

FOLDER_OPTIONS = ("engine", "address", "workers", "threads", "shard")


def add_folder_options(parser: argparse.ArgumentParser) -> None:
    """``--engine``, ``--address``, ``--workers``, ``--threads`` and ``--shard``."""
    group = parser.add_argument_group("folders of partitions")
    group.add_argument(
        "--engine", choices=["local", "ray"], help="processes of this machine (default), or a Ray cluster"
    )
    group.add_argument("--address", metavar="A", help="of an existing Ray cluster; default: one started for the job")
    group.add_argument(
        "--workers", type=count, metavar="N", help="worker processes (default: one a core of this machine)"
    )
    group.add_argument("--threads", type=count, metavar="N", help="threads of each worker (default 1)")
    group.add_argument("--shard", metavar="i/N", help="do only every N-th partition, beginning with number i")


def refuse_options(args: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Refuse options that mean nothing here.

    Raises:
        ConfigError: one was given.
    """
    for name in names:
        if getattr(args, name) not in (None, False):
            raise ConfigError(f"--{name.replace('_', '-')} {why}")


def check_folder(output: str, inputs: Sequence[Path] = ()) -> JobFolder:
    """An output folder, which must not be among what is read.

    Raises:
        DataError: it looks like a file, or lies where the inputs lie.
    """
    from ikgrad.files.writers import SUFFIXES
    from ikgrad.jobs.folder import JobFolder

    path = Path(output)
    if path.suffix.lower() in SUFFIXES:
        raise DataError(f"{path}: names a file, and a folder of partitions is to be written; leave out the suffix")
    here = path.resolve()
    for given in inputs:
        there = given.resolve()
        if here == there:
            raise DataError(f"{path}: is the input; choose another folder for the output")
        if there in here.parents or here in there.parents:
            raise DataError(f"{path}: the folders of input and output lie inside one another; put them side by side")
    return JobFolder(path)


@dataclass
class Done:
    """What a run over folders did."""

    records: list[Record]
    job: Job
    missing: list[str]  # partitions that other shards have still to do
    rate: float
    seconds: float

    @property
    def fresh(self) -> list[Record]:
        """What was done now."""
        return [record for record in self.records if record["fresh"]]

    def rows(self) -> list[list[str]]:
        """What is said of partitions, for a table."""
        kept = len(self.records) - len(self.fresh)
        rows = [["partitions", f"{len(self.fresh):,} done" + (f", {kept:,} found finished" if kept else "")]]
        rows += [
            ["done again", f"'{record['name']}' {record['redone']}"] for record in self.records if "redone" in record
        ]
        if self.missing:
            rows.append(["left for other shards", f"{len(self.missing):,} of {len(self.job['partitions']):,}"])
        split = self.split()
        if split:
            rows.append(["time of the workers", ", ".join(f"{name} {share:.0%}" for name, share in split.items())])
            rows.append(["peak memory of a worker", f"{self.peak_memory() / 1e6:,.0f} MB"])
        return rows

    def peak_memory(self) -> int:
        """Of the worker that needed most [bytes]."""
        return max((record["peak_memory"] for record in self.fresh), default=0)

    def split(self) -> dict[str, float]:
        """Share of the workers' time by what it was spent on."""
        times = [record["seconds"] for record in self.fresh]
        total = sum(seconds["total"] for seconds in times)
        names = [name for name in (times[0] if times else {}) if name != "total"]
        return {name: sum(seconds.get(name, 0.0) for seconds in times) / total for name in names} if total else {}

    def document(self) -> dict[str, Any]:
        """The same for programs."""
        return {
            "partitions": len(self.job["partitions"]),
            "done": len(self.fresh),
            "found_finished": len(self.records) - len(self.fresh),
            "done_again": {record["name"]: record["redone"] for record in self.records if "redone" in record},
            "left_for_other_shards": len(self.missing),
            "time_split": self.split(),
            "peak_memory_bytes": self.peak_memory(),
            "poses_per_second": self.rate,
            "seconds": self.seconds,
        }

    def end_rows(self, output: str) -> list[list[str]]:
        """Speed, time and place."""
        speed = [["speed", f"{self.rate:,.0f} poses/s"]] if self.fresh else []
        return [*speed, ["time", duration(self.seconds)], ["written", output]]


def run_folders(args: argparse.Namespace, what: str, task: Task, outputs: Sequence[tuple[JobFolder, Job]]) -> Done:
    """Do all partitions, or those of a shard, and write the manifests if nothing is missing after it.

    Args:
        args: the options of `add_folder_options`, ``resume`` and ``force``.
        what: is done, for the progress.
        task: does one partition.
        outputs: the folders that it fills, each with its job; all have the same partitions.
    """
    from ikgrad.jobs.manifest import finish

    begin = time.perf_counter()
    engine, shard = _engine(args), _shard(args)
    job = outputs[0][1]
    sizes = {name: given["rows"] for name, given in job["partitions"].items()}
    own = shard.of(list(sizes)) if shard else list(sizes)
    for place, its_job in outputs:
        place.begin(its_job, own, resume=args.resume, force=args.force)
    records: list[Record] = []
    with (
        _keeping([place for place, _ in outputs], own),
        Progress(what, sum(sizes[name] for name in own), "poses") as bar,
        contextlib.closing(
            engine(task, own)
        ) as outcomes,  # whatever happens, workers are gone before the folder is swept
    ):
        for record in outcomes:
            records.append(record)
            (bar.advance if record["fresh"] else bar.skip)(sizes[record["name"]])
        rate = bar.rate
        missing: list[str] = []
        for place, its_job in outputs:
            missing = finish(place, its_job)  # the same for all
            place.sweep()
    return Done(records, job, missing, rate, time.perf_counter() - begin)


def _shard(args: argparse.Namespace) -> Shard | None:
    from ikgrad.jobs.partitions import Shard

    return Shard.parse(args.shard) if args.shard else None


def _engine(args: argparse.Namespace) -> Callable[[Task, Sequence[str]], Generator[Record, None, None]]:
    workers, threads = args.workers or max(1, _cores() // (args.threads or 1)), args.threads or 1
    if args.engine == "ray":
        if args.address and args.workers is None:
            raise ConfigError("--address needs --workers: how many the cluster shall run")
        check("ray", extra="distributed", what="Ray clusters")
        from ikgrad.jobs.ray_engine import run_ray

        return lambda task, names: run_ray(task, names, workers=workers, threads=threads, address=args.address)
    if args.address:
        raise ConfigError("--address is that of a Ray cluster; it needs --engine ray")
    from ikgrad.jobs import run_local

    return lambda task, names: run_local(task, names, workers=workers, threads=threads)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _keeping(places: Sequence[JobFolder], own: Sequence[str]) -> Iterator[None]:
    """Whatever ends the work, finished partitions stay, and it is said how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted; {_what_is_kept(places, own)}") from None
    except OSError as error:
        raise DataError(f"{describe(error)}; {_what_is_kept(places, own)}") from error


def _what_is_kept(places: Sequence[JobFolder], own: Sequence[str]) -> str:
    for place in places:
        place.sweep()
    finished = len(places[0].records(own))
    if not finished:
        return "no partition was finished; the same command with --resume begins again"
    return (
        f"{finished:,} of {len(own):,} partitions are finished and kept in {places[0].path}, "
        "the same command with --resume goes on from there"
    )
