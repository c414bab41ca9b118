"""``ikgrad merge``: the shards of a job become one folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from ikgrad.cli.parsing import Commands, example
from ikgrad.cli.solve_report import summary_rows
from ikgrad.cli.terminal import Interrupted, Progress, print_json, print_table
from ikgrad.errors import ConfigError, DataError, describe

DESCRIPTION = """\
put the shards of `ikgrad solve --shard` or `ikgrad sample --shard` together.

One FOLDER that all shards wrote to: every partition must be there and have the bytes that were written; then
_manifest.json is written, with a checksum for each. Several folders, one or more shards in each: their partitions
are verified and moved (or copied) into OUT first. What is missing or damaged is listed, and nothing is moved then."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "merge",
        help="put the shards of a job together, and verify them",
        description=DESCRIPTION,
        epilog=example("ikgrad merge joints/\nikgrad merge node1/joints node2/joints -o joints/ --copy"),
    )
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help="output folders of shards")
    parser.add_argument("-o", "--output", metavar="OUT", help="where they come together; default: the only FOLDER")
    parser.add_argument("--copy", action="store_true", help="copy the partitions and leave the shards as they are")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Merge, and say what came out."""
    if args.output is None and len(args.folders) > 1:
        raise ConfigError("several folders come together in one: name it with -o OUT")
    from ikgrad.jobs.answers import Summary
    from ikgrad.jobs.merge import merge, rows_of

    folders, output = [Path(folder) for folder in args.folders], Path(args.output or args.folders[0])
    try:
        with Progress("merge", rows_of(folders, output), "poses") as progress:
            merged = merge(folders, output, copy=args.copy, advance=progress.advance)
    except KeyboardInterrupt:
        raise Interrupted("interrupted; the same command goes on") from None
    except OSError as error:
        raise DataError(f"{describe(error)}; the same command goes on") from error
    if args.json:
        print_json({**merged.totals, "brought": merged.moved, "output": str(output)})
        return 0
    totals = merged.totals
    rows = [["partitions", f"{totals['partitions']:,}, all verified"], ["rows", f"{totals['rows']:,}"]]
    if "counts" in totals:
        summary = Summary(totals["counts"]["solutions"])
        summary.include(totals["counts"])
        rows += summary_rows(summary)
    if merged.moved:
        rows.append(["copied" if args.copy else "moved", f"{merged.moved:,} partitions"])
    rows.append(["written", str(output / "_manifest.json")])
    print_table("ikgrad merge", ["", ""], rows)
    return 0
