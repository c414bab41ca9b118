"""``ikgrad sample`` where POSES is a folder of partitions."""

from __future__ import annotations

import argparse
from pathlib import Path

from ikgrad.cli.folders import check_folder, refuse_options, run_folders
from ikgrad.cli.terminal import print_json, print_table
from ikgrad.errors import ConfigError

ROWS = 250_000


def run(args: argparse.Namespace) -> int:
    """Sample a folder."""
    refuse_options(args, ["sobol"], "is for a single file; the partitions of a folder are drawn independently")
    from ikgrad.jobs.sampling import SampleTask
    from ikgrad.robot import load_robot

    output = check_folder(args.output)
    joints = check_folder(args.joints) if args.joints else None
    if joints is not None and _inside(joints.path.resolve(), output.path.resolve()):
        raise ConfigError("-o and --joints name the same folder, or one inside the other; put them side by side")
    robot = load_robot(args.robot, base=args.base, tip=args.tip)
    places = output.absolute(), joints.absolute() if joints else None
    task = SampleTask(robot, *places, args.count, args.partition_rows or ROWS, args.seed)
    outputs = [(output, task.job("poses"))] + ([(joints, task.job("joints"))] if joints else [])
    done = run_folders(args, "sample", task, outputs)
    if args.json:
        about = {"robot": robot.name, "poses": args.count, "seed": args.seed}
        print_json({**about, **done.document(), "output": args.output, "joints": args.joints})
        return 0
    poses = sum(record["rows"] for record in done.records)
    rows = [["poses", f"{poses:,}"], *done.rows(), *done.end_rows(args.output)]
    rows += [["joints", args.joints]] if args.joints else []
    print_table(f"ikgrad sample: {robot.name}, seed {args.seed}", ["", ""], rows)
    return 0


def _inside(a: Path, b: Path) -> bool:
    return a == b or a in b.parents or b in a.parents
