"""Shards put together: every partition is there once and has the bytes that were written, and a manifest says so."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from ikgrad.errors import DataError
from ikgrad.files.places import in_one_move
from ikgrad.jobs.folder import JOB, MANIFEST, RECORDS, Job, JobFolder, job_differences
from ikgrad.jobs.manifest import manifest
from ikgrad.jobs.partitions import list_names
from ikgrad.jobs.task import Record

SHOWN = 10  # names in a message


class Copy(NamedTuple):
    """A finished partition in one of the folders."""

    folder: JobFolder
    record: Record


class Merged(NamedTuple):
    """What was put together."""

    folder: JobFolder
    totals: dict[str, Any]
    moved: int


def merge(
    folders: Sequence[Path], output: Path, *, copy: bool = False, advance: Callable[[int], None] = lambda rows: None
) -> Merged:
    """Check the shards of a job, bring their partitions into one folder, and write the manifest.

    What is stopped can be called again: a partition leaves its shard when it is in ``output``, with its record.

    Args:
        folders: where the shards are.
        output: where they come together; may be one of ``folders``.
        copy: leave the shards as they are.
        advance: called with the rows of each partition that was verified.

    Raises:
        DataError: different jobs, partitions that are missing, damaged, strange, or there twice with other content.
    """
    target, places = JobFolder(output), _places(folders, output)
    job = _one_job(places)
    copies = _gather(places, job, advance)
    target.begin(job, list(job["partitions"]), resume=True)
    moved = 0
    for name, found in copies.items():
        if found[0].folder != target:
            _bring(name, found[0], target, copy=copy)
            moved += 1
    whole = manifest(job, {name: found[0].record for name, found in copies.items()})
    target.write_manifest(whole)
    if not copy:
        for place in places:
            if place != target:
                _empty(place, job)
    return Merged(target, whole["totals"], moved)


def _places(folders: Sequence[Path], output: Path) -> list[JobFolder]:
    """Where partitions may lie, the output first if there is one already."""
    shards = [JobFolder(path) for path in folders if path.resolve() != output.resolve()]
    if not (output / JOB).exists():
        return shards or [JobFolder(output)]
    # shards may have been emptied and removed by a call that was stopped
    return [JobFolder(output), *(shard for shard in shards if shard.path.exists())]


def rows_of(folders: Sequence[Path], output: Path) -> int:
    """Rows of the whole job."""
    job = _places(folders, output)[0].read_job()
    return sum(given["rows"] for given in job["partitions"].values())


def _one_job(places: Sequence[JobFolder]) -> Job:
    jobs = [place.read_job() for place in places]
    for place, job in zip(places, jobs, strict=True):
        differs = job_differences(jobs[0], job)
        if differs:
            raise DataError(f"{place.path}: is a shard of another job than {places[0].path}: {'; '.join(differs)}")
        strange = [name for name in list_names_or_none(place.path) if name not in job["partitions"]]
        if strange:
            raise DataError(f"{place.path}: {_some(strange)} no part of this job and must not lie there")
    return jobs[0]


def list_names_or_none(folder: Path) -> list[str]:
    """Names of partitions; a shard may have had none to do."""
    return list_names(folder) if any(folder.glob("[!_.]*")) else []


def _gather(places: Sequence[JobFolder], job: Job, advance: Callable[[int], None]) -> dict[str, list[Copy]]:
    """The copies of each partition, verified, one at least.

    Raises:
        DataError: with what is missing, damaged, or not the same twice.
    """
    names = list(job["partitions"])

    def look(name: str) -> tuple[list[Copy], list[str]]:
        found = [(place, place.check(name)) for place in places]
        whole = [Copy(place, look.record) for place, look in found if look.record is not None]
        return whole, [f"'{name}' in {place.path} {look.wrong}" for place, look in found if look.wrong]

    copies: dict[str, list[Copy]] = {}
    missing, damaged, double = [], [], []
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # hashing lets go of the interpreter lock
        for name, (whole, wrong) in zip(names, pool.map(look, names), strict=True):
            advance(job["partitions"][name]["rows"])
            copies[name] = whole
            if not whole and wrong:
                damaged += wrong
            elif not whole:
                missing.append(name)
            elif len({copy.record["sha256"] for copy in whole}) > 1:
                double.append(name)
    if double:
        raise DataError(f"{_some(double)} there more than once, with different content; remove the wrong ones")
    if damaged:
        raise DataError(f"partition {'; '.join(damaged[:SHOWN])}; do the shard again with --resume")
    if missing:
        here = ", ".join(str(place.path) for place in places)
        raise DataError(f"{_some(missing)} missing of {len(names):,} in {here}; do the shards again with --resume")
    return copies


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:SHOWN])
    rest = f" and {len(names) - SHOWN:,} more" if len(names) > SHOWN else ""
    return f"partition {shown} is" if len(names) == 1 else f"partitions {shown}{rest} are"


def _bring(name: str, found: Copy, target: JobFolder, *, copy: bool) -> None:
    """One partition into the target: its record first, so that it is whole in one of the two folders at any time."""
    source = found.folder.partition(name)
    target.keep(found.record)
    if not copy:
        try:
            os.replace(source, target.partition(name))
            return
        except OSError:  # another file system
            pass
    with in_one_move(target.partition(name), force=True) as temporary:
        shutil.copyfile(source, temporary)
    wrong = target.check(name).wrong
    if wrong:
        raise DataError(f"{target.partition(name)}: {wrong} after it was copied; try again")


def _empty(place: JobFolder, job: Job) -> None:
    """Remove a shard whose partitions are all in the target; what is not ours stays."""
    for name in job["partitions"]:
        place.partition(name).unlink(missing_ok=True)
        (place.path / RECORDS / f"{name}.json").unlink(missing_ok=True)
    for path in (place.path / MANIFEST, place.path / JOB):
        path.unlink(missing_ok=True)
    place.sweep()
    for folder in (place.path / RECORDS, place.path):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
