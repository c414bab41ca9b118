"""An output folder: partitions, a record for each finished one, and what job they belong to.

    OUT/_job.json            what the job is: robot, settings, versions, the list of partitions
    OUT/_records/NAME.json   written after each partition: its rows, size, checksum and counts
    OUT/NAME.parquet         the partitions; Parquet readers pass over names that begin with _
    OUT/_manifest.json       the job, all records and totals, when every partition is there

Every file appears in one move, and no process needs to know of another: any number of them, on any machines that see
the folder, may write different partitions at the same time.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ikgrad.errors import DataError
from ikgrad.files.partial import differences
from ikgrad.files.places import HOST, in_one_move
from ikgrad.jobs.partitions import SUFFIX, changed_partitions
from ikgrad.jobs.task import Record

JOB, RECORDS, MANIFEST = "_job.json", "_records", "_manifest.json"
Job = dict[str, Any]
"""What a job is, as flat JSON values under readable names, and ``partitions``: name -> what its input is."""

_TEMPORARY = re.compile(r"\..*\.([^.]+)\.(\d+)\.tmp(\.\w+)?", re.DOTALL)


class Found(NamedTuple):
    """What a look at a partition says."""

    record: Record | None  # None: it has to be done
    wrong: str | None = None  # what is wrong with the file that is there although it was finished once


@dataclass(frozen=True)
class JobFolder:
    """The place of a job's output."""

    path: Path

    def absolute(self) -> JobFolder:
        """The same place for processes that stand elsewhere."""
        return JobFolder(self.path.absolute())

    def partition(self, name: str) -> Path:
        """Where a partition lies."""
        return self.path / f"{name}{SUFFIX}"

    def _record(self, name: str) -> Path:
        return self.path / RECORDS / f"{name}.json"

    # ------------------------------------------------------------ the job

    def job(self) -> Job:
        """The description, read again only if it is another file than last time.

        Raises:
            DataError: there is none.
        """
        path = self.path / JOB
        if not path.exists():
            return self.read_job()  # which says what is wrong
        stat = path.stat()
        return _read_once(self.absolute(), (stat.st_ino, stat.st_mtime_ns, stat.st_size))

    def read_job(self) -> Job:
        """The description that is there.

        Raises:
            DataError: there is none, or it cannot be read.
        """
        path = self.path / JOB
        try:
            job = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise DataError(f"{self.path}: holds no job ({JOB} is not there)") from error
        except (OSError, ValueError) as error:
            raise DataError(f"{path}: cannot be read, so the job cannot go on; --force starts anew") from error
        if not isinstance(job, dict) or not isinstance(job.get("partitions"), dict):
            raise DataError(f"{path}: is no description of a job; --force starts anew")
        return job

    def begin(self, job: Job, own: Sequence[str], *, resume: bool = False, force: bool = False) -> None:
        """Make the folder ready for some partitions of a job, or refuse.

        The first process that comes describes the job; all others must mean the same one.

        Args:
            job: what is to be done.
            own: the partitions that this process is going to do.
            resume: go on with what is there.
            force: remove what is there; with only a part of the partitions in ``own``, only these.

        Raises:
            DataError: another job is there, or other files; or own partitions are there and neither is given.
        """
        self._make()
        if force and not resume:
            self._clear(job, own)
        if not (self.path / JOB).exists():
            self._refuse_strangers()
            self._describe(job)
        differs = job_differences(self.read_job(), job)
        if differs:
            anew = (
                "--force starts anew" if set(own) >= set(job["partitions"]) else "--force without --shard starts anew"
            )
            raise DataError(f"{self.path}: cannot go on with another job: {'; '.join(differs)}; {anew}")
        if not resume and any(self.partition(name).exists() or self._record(name).exists() for name in own):
            finished = (self.path / MANIFEST).exists()
            kind, goes_on = ("a finished job", "verifies it") if finished else ("an unfinished job", "goes on with it")
            raise DataError(f"{self.path}: holds {kind}; --resume {goes_on}, --force starts anew")
        (self.path / RECORDS).mkdir(exist_ok=True)
        self.sweep()

    def _make(self) -> None:
        if not self.path.parent.is_dir():
            raise DataError(f"{self.path}: the folder '{self.path.parent}' does not exist; create it first")
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{self.path}: is a file, not a folder")
        self.path.mkdir(exist_ok=True)

    def _refuse_strangers(self) -> None:
        for entry in sorted(os.listdir(self.path)):
            if not entry.startswith(".") and not (self.path / JOB).exists():  # another process may just have come
                raise DataError(f"{self.path}: holds '{entry}' and no job; choose a new or an empty folder")

    def _describe(self, job: Job) -> None:
        """Write the description unless another process was faster; readers never see half of it."""
        path, text = self.path / JOB, json.dumps(job, indent=1) + "\n"
        temporary = path.with_name(f".{path.stem}.{HOST}.{os.getpid()}.tmp{path.suffix}")
        try:
            temporary.write_text(text, encoding="utf-8")
            with contextlib.suppress(FileExistsError):
                try:
                    os.link(temporary, path)
                except FileExistsError:
                    raise
                except OSError:  # a file system without links
                    with open(path, "x", encoding="utf-8") as file:
                        file.write(text)
        finally:
            temporary.unlink(missing_ok=True)

    # ------------------------------------------------------------ partitions

    def check(self, name: str) -> Found:
        """Whether a partition is finished and its file still has the bytes that were written."""
        record = self._read_record(name)
        if not isinstance(record, dict):
            return Found(None, record)
        path = self.partition(name)
        try:
            size = path.stat().st_size
            if size != record["bytes"]:
                return Found(None, f"has {size:,} bytes, had {record['bytes']:,}")
            with open(path, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except FileNotFoundError:
            return Found(None, "is gone")
        return Found(record) if digest == record["sha256"] else Found(None, "does not hold what was written")

    def _read_record(self, name: str) -> Record | str | None:
        """The record; what is wrong with it; or None if there is none."""
        try:
            record = json.loads(self._record(name).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except ValueError:
            return "has a damaged record"
        whole = isinstance(record, dict) and {"name", "rows", "bytes", "sha256"} <= set(record)
        return record if whole and record["name"] == name else "has a damaged record"

    def keep(self, record: Record) -> None:
        """Note that a partition is finished; a note that a power cut takes costs no more than doing it again."""
        with in_one_move(self._record(record["name"]), force=True, durable=False) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")

    def records(self, names: Sequence[str]) -> dict[str, Record]:
        """The records that are there, by name; nothing is verified."""
        found = ((name, self._read_record(name)) for name in names)
        return {name: record for name, record in found if isinstance(record, dict)}

    # ------------------------------------------------------------ the end

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Put the manifest in place; every process that finds all partitions there writes the same."""
        with in_one_move(self.path / MANIFEST, force=True) as temporary:
            temporary.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")

    # ------------------------------------------------------------ cleaning

    def temporaries(self) -> Iterator[Path]:
        """Files that processes of this machine began and that nobody will finish: their process is gone."""
        for folder in (self.path, self.path / RECORDS):
            for entry in sorted(os.listdir(folder)) if folder.is_dir() else []:
                match = _TEMPORARY.fullmatch(entry)
                if match and match[1] == HOST and not _alive(int(match[2])):
                    yield folder / entry

    def sweep(self) -> None:
        """Remove them; those of living processes, and of other machines, stay."""
        for path in list(self.temporaries()):
            path.unlink(missing_ok=True)

    def _clear(self, job: Job, own: Sequence[str]) -> None:
        """Remove what is there, as far as it is ours: all of it, or the own partitions if others do the rest."""
        names = set(own)
        if names >= set(job["partitions"]):
            with contextlib.suppress(DataError):
                names |= set(self.read_job()["partitions"])
            (self.path / JOB).unlink(missing_ok=True)
        (self.path / MANIFEST).unlink(missing_ok=True)
        for name in names:
            self._record(name).unlink(missing_ok=True)
            self.partition(name).unlink(missing_ok=True)
        self.sweep()
        if not (self.path / JOB).exists():
            with contextlib.suppress(OSError):  # there is something in it that is not ours
                (self.path / RECORDS).rmdir()


@lru_cache(maxsize=4)
def _read_once(folder: JobFolder, _stamp: tuple[int, ...]) -> Job:
    return folder.read_job()


def job_differences(before: Job, now: Job) -> list[str]:
    """What differs between two jobs, in words; nothing if their partitions may be mixed."""
    flat = [{name: value for name, value in job.items() if name != "partitions"} for job in (before, now)]
    return differences(*flat) + changed_partitions(before["partitions"], now["partitions"])


def _alive(pid: int) -> bool:
    if os.name != "posix":
        return True  # asking means killing there
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
