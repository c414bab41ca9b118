"""``ikgrad sample``: reachable poses, by forward kinematics of configurations inside the limits."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path

from ikgrad.cli.folders import FOLDER_OPTIONS, add_folder_options, refuse_options
from ikgrad.cli.parsing import Commands, add_robot_options, count, example, seed
from ikgrad.cli.terminal import Progress, print_json
from ikgrad.errors import ConfigError

CHUNK = 16_384

FOLDER = """\
POSES without a suffix is a folder of Parquet files, of any size in all, made by several processes. Each file has
random numbers of its own, so the poses are others than those of a single file with the same seed."""


def add(commands: Commands) -> None:
    """Add the command."""
    text = "random poses that the robot can reach inside its limits"
    parser = commands.add_parser(
        "sample",
        help=text,
        description=f"{text}. The same seed gives the same poses.\n\n{FOLDER}",
        epilog=example(
            "ikgrad sample --robot panda --count 1000 --seed 0 -o poses.csv --joints q.csv\n"
            "ikgrad sample --robot panda --count 10000000 -o poses/"
        ),
    )
    add_robot_options(parser)
    parser.add_argument("--count", type=count, required=True, metavar="N", help="how many poses")
    parser.add_argument("--seed", type=seed, default=0, help="of the random numbers (default 0)")
    parser.add_argument("--sobol", action="store_true", help="a scrambled Sobol sequence: more even than random")
    parser.add_argument(
        "-o", "--output", required=True, metavar="POSES", help="CSV, NPY, NPZ or Parquet, by suffix; or a folder"
    )
    parser.add_argument("--joints", metavar="JOINTS", help="also write the configurations; likewise")
    parser.add_argument("--force", action="store_true", help="overwrite existing outputs")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    add_folder_options(parser)
    parser.add_argument(
        "--partition-rows", type=count, metavar="ROWS", help="poses of each file of a folder (default 250000)"
    )
    parser.add_argument("--resume", action="store_true", help="go on with a folder that was begun")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the files, or the folders."""
    if not Path(args.output).suffix or Path(args.output).is_dir():
        from ikgrad.cli import sample_folder

        return sample_folder.run(args)
    only = [*FOLDER_OPTIONS, "partition_rows", "resume"]
    refuse_options(args, only, "is for a folder of poses; POSES has a suffix, so it is a file")
    from ikgrad.data import sample_configurations
    from ikgrad.files import check_output, joint_writer, pose_writer
    from ikgrad.files.joints import OUT_SUFFIXES, check_joint_names
    from ikgrad.files.writers import SUFFIXES
    from ikgrad.kinematics import forward_kinematics
    from ikgrad.robot import load_robot

    check_output(args.output, SUFFIXES, force=args.force)
    if args.joints is not None:
        check_output(args.joints, OUT_SUFFIXES, force=args.force)
        if Path(args.joints).absolute() == Path(args.output).absolute():
            raise ConfigError("-o and --joints name the same file")
    robot = load_robot(args.robot, base=args.base, tip=args.tip)
    if args.joints is not None:
        check_joint_names(Path(args.joints), robot)
    q = sample_configurations(robot, args.count, seed=args.seed, sobol=args.sobol)
    with ExitStack() as stack:
        poses = stack.enter_context(pose_writer(args.output, force=args.force))
        joints = stack.enter_context(joint_writer(args.joints, robot, force=args.force)) if args.joints else None
        progress = stack.enter_context(Progress("sample", args.count, "poses"))
        for part in q.split(CHUNK):
            poses.append(forward_kinematics(robot, part))
            if joints is not None:
                joints.append({"q": part.numpy()})
            progress.advance(len(part))
    if args.json:
        print_json({"robot": robot.name, "poses": args.count, "seed": args.seed, "output": args.output})
    else:
        print(f"{args.count:,} reachable poses of {robot.name} -> {args.output}")
    return 0
