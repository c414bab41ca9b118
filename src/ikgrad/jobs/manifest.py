"""The end of a job: all partitions are there, and one file says what they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ikgrad.jobs.answers import Summary
from ikgrad.jobs.folder import Job, JobFolder
from ikgrad.jobs.task import Record

KEPT = ("rows", "bytes", "sha256", "counts")  # of a record; times differ from run to run


def finish(folder: JobFolder, job: Job) -> list[str]:
    """Write the manifest if every partition has its record.

    It holds nothing that differs between two runs of the same job, so neither do its bytes.

    Returns:
        The partitions that are not there yet; another process may be at work on them.
    """
    records = folder.records(list(job["partitions"]))
    missing = [name for name in job["partitions"] if name not in records]
    if not missing:
        folder.write_manifest(manifest(job, records))
    return missing


def manifest(job: Job, records: Mapping[str, Record]) -> dict[str, Any]:
    """The job, each partition with its input and its output, and totals."""
    partitions = {
        name: {"input": given, **{key: records[name][key] for key in KEPT if key in records[name]}}
        for name, given in job["partitions"].items()
    }
    return {**job, "partitions": partitions, "totals": totals(records[name] for name in partitions)}


def totals(records: Iterable[Record]) -> dict[str, Any]:
    """Rows, bytes and counts of several partitions."""
    records = list(records)
    summary = summary_of(records)
    sums = {key: sum(record[key] for record in records) for key in ("rows", "bytes")}
    return {"partitions": len(records), **sums} | ({"counts": summary.counts()} if summary else {})


def summary_of(records: Iterable[Record]) -> Summary | None:
    """What the rows of several partitions say; None if they are not the kind that says anything."""
    summary: Summary | None = None
    for record in records:
        if "counts" in record:
            summary = summary or Summary(record["counts"]["solutions"])
            summary.include(record["counts"])
    return summary
