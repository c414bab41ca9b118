"""``ikgrad map``: which poses a robot reaches, over a grid of positions and a set of orientations."""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.parsing import Commands, add_robot_options, count, example, mask, positive, seed
from ikgrad.cli.terminal import Progress, duration, print_json, print_table, stop_between_steps
from ikgrad.errors import ConfigError

if TYPE_CHECKING:
    from ikgrad.files import PartialRun
    from ikgrad.workspace import Survey, WorkspaceMap

KEEP_EVERY = 15.0  # seconds between two savings

DESCRIPTION = """\
reachability and manipulability: cells over the reach of the arm, the same orientations tried in each of them.

One row a cell: share of the orientations that are reached, share that is out of reach for certain, smallest
condition number, largest manipulability, and the joints with that condition number. Robots with fewer than six
joints need a --mask with as many directions as they have joints, or fewer. Ctrl-C waits for the orientation at hand
and keeps what is done in OUTPUT.partial; the same command with --resume goes on from there."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "map",
        help="which poses a robot reaches, cell by cell",
        description=DESCRIPTION,
        epilog=example(
            "ikgrad map --robot panda -o panda_map.parquet --plot panda_map.png\n"
            "ikgrad map --robot arm4 --mask 1,1,1,0,0,0 --cell 1 -o arm4_map.csv\n"
            "ikgrad map --robot ur5e --cell 0.05 --solutions 64 -o ur5e_map.parquet"
        ),
    )
    add_robot_options(parser)
    parser.add_argument("-o", "--output", metavar="MAP", help="Parquet, CSV or NPZ (default ROBOT_map.parquet)")
    parser.add_argument("--cell", type=positive, default=0.02, metavar="M", help="edge of a cell [m] (0.02)")
    parser.add_argument("--orientations", type=count, default=50, metavar="N", help="tried in each cell (50)")
    text = "which of x,y,z,rx,ry,rz count, along the target's axes; 1,1,1,0,0,0 is position only"
    parser.add_argument("--mask", type=mask, metavar="1,1,1,1,1,1", help=text)
    parser.add_argument("--starts", type=count, default=16, metavar="N", help="starts of the solver a pose (16)")
    text = "also count different solutions, with K more random starts a pose reached (slow: each start costs a solve)"
    parser.add_argument("--solutions", type=count, default=0, metavar="K", help=text)
    parser.add_argument("--tol-pos", type=positive, default=1e-6, metavar="M", help="largest error [m] (1e-6)")
    parser.add_argument("--tol-rot", type=positive, default=1e-6, metavar="RAD", help="largest error [rad] (1e-6)")
    parser.add_argument("--seed", type=seed, default=0, help="of the random starts (default 0)")
    parser.add_argument("--plot", metavar="FILE", help="also draw slices and a view in space (PNG or SVG)")
    parser.add_argument("--force", action="store_true", help="overwrite existing outputs")
    parser.add_argument("--resume", action="store_true", help="go on with a run that was stopped")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Search, write the table, draw, print the summary."""
    from ikgrad.cli.solve_job import keeping
    from ikgrad.files import PartialRun
    from ikgrad.robot import load_robot

    robot = load_robot(args.robot, base=args.base, tip=args.tip)
    output = _check_places(args, robot.name)
    survey = _survey(args, robot)
    parts = PartialRun.open(output, survey.manifest(), resume=args.resume, force=args.force)
    begin = time.perf_counter()
    with keeping(parts, keep_on_error=True):
        _search(survey, parts)
        found = survey.result()
        found.save(output, force=args.force, folder=parts.folder)
    seconds = time.perf_counter() - begin
    parts.discard()
    if args.plot:
        _plot(found, args)
    _report(args, found, output, seconds)
    return 0


def _check_places(args: argparse.Namespace, name: str) -> Path:
    """All that can be wrong about outputs, before any work is done."""
    from ikgrad.files import check_output
    from ikgrad.workspace.result import SUFFIXES

    given = args.output or re.sub(r"[^\w.-]", "_", name) + "_map.parquet"
    output = check_output(given, SUFFIXES, force=args.force)
    if output.suffix.lower() == ".parquet":
        from ikgrad.files.parquet_table import pyarrow_parquet

        pyarrow_parquet(output)  # say now that it is not installed
    if args.plot:
        plot = check_output(args.plot, (".png", ".svg"), force=args.force)
        if plot.absolute() == output.absolute():
            raise ConfigError("-o and --plot name the same file")
    return output


def _survey(args: argparse.Namespace, robot: Any) -> Survey:
    from ikgrad.workspace import Survey

    return Survey(
        robot, cell=args.cell, orientations=args.orientations, mask=args.mask, starts=args.starts,
        solutions=args.solutions, tol_pos=args.tol_pos, tol_rot=args.tol_rot, seed=args.seed,
    )  # fmt: skip


def _search(survey: Survey, parts: PartialRun) -> None:
    """All orientations that are not done; the state is kept every few seconds and when the run is stopped."""
    if parts.finished:
        survey.restore(parts.load(0))
    kept, saved = survey.done, time.monotonic()
    with stop_between_steps() as check, Progress("map", len(survey.rotations), "orientations") as progress:
        progress.skip(survey.done)
        try:
            while not survey.finished:
                survey.step()
                progress.advance(1)
                if time.monotonic() - saved > KEEP_EVERY:
                    parts.save(0, survey.state())
                    kept, saved = survey.done, time.monotonic()
                check()
        except KeyboardInterrupt:
            if survey.done > kept:
                parts.save(0, survey.state())
            raise


def _plot(found: WorkspaceMap, args: argparse.Namespace) -> None:
    from ikgrad.plots import save_figure, workspace_map

    cells = found.centres.numpy(), found.share.numpy(), found.condition.numpy()
    tried = f"{len(found.orientations)} orientations" if any(found.mask[3:]) else "position only"
    title = f"{found.robot.name}: {len(found.centres):,} cells of {100 * found.cell:g} cm, {tried}"
    save_figure(workspace_map(*cells, cell=found.cell, title=title), args.plot, force=args.force)


def _report(args: argparse.Namespace, found: WorkspaceMap, output: Path, seconds: float) -> None:
    if args.json:
        print_json(_document(args, found, output, seconds))
        return
    undecided = found.poses - found.reached - found.proven_unreachable
    reached = found.share > 0
    rows = [
        ["cells", f"{len(found.centres):,} of {found.cell:g} m, {len(found.orientations)} orientations"],
        ["poses reached", _part(found.reached, found.poses)],
        ["out of reach for certain", _part(found.proven_unreachable, found.poses)],
        ["searched, not found", _part(undecided, found.poses)],
        ["volume reached", f"{found.volume:.4g} m^3, in all orientations {found.dexterous_volume:.4g} m^3"],
    ]
    if reached.any():
        best = int(found.condition.argmin())
        place = ", ".join(f"{x:.3g}" for x in found.centres[best].tolist())
        rows.append(["smallest condition number", f"{float(found.condition[best]):.3g} at ({place}) m"])
        rows.append(["largest manipulability", f"{float(found.manipulability.max()):.3g}"])
        if found.solutions_mean is not None and found.solutions_most is not None:
            mean, most = float(found.solutions_mean[reached].mean()), int(found.solutions_most.max())
            rows.append(["different solutions", f"{mean:.3g} on average, at most {most}"])
    rows += [["time", duration(seconds)], ["written", str(output)]]
    rows += [["drawn", args.plot]] if args.plot else []
    print_table(f"ikgrad map: {found.robot.name}", ["", ""], rows)


def _part(number: int, of: int) -> str:
    return f"{number:,} of {of:,} ({100 * number / of:.2f} %)"


def _document(args: argparse.Namespace, found: WorkspaceMap, output: Path, seconds: float) -> dict[str, Any]:
    from ikgrad.rotations import quat_wxyz_from_matrix

    counted = found.solutions_most is not None
    return {
        "robot": found.robot.name,
        "cells": len(found.centres),
        "cell_m": found.cell,
        "orientations_quat_wxyz": quat_wxyz_from_matrix(found.orientations).tolist(),
        "mask": found.mask,
        "poses": found.poses,
        "reached": found.reached,
        "unreachable": found.proven_unreachable,
        "volume_m3": found.volume,
        "dexterous_volume_m3": found.dexterous_volume,
        "smallest_condition": float(found.condition.min()),
        "largest_manipulability": float(found.manipulability.max()),
        "most_solutions": int(found.solutions_most.max()) if counted else None,  # type: ignore[union-attr]
        "seconds": seconds,
        "output": str(output),
        "plot": args.plot,
    }
