"""``ikgrad sample``: reachable poses, by forward kinematics of configurations inside the limits."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path

from ikgrad.cli.parsing import Commands, add_robot_options, count, example, seed
from ikgrad.cli.terminal import Progress, print_json
from ikgrad.errors import ConfigError

CHUNK = 16_384


def add(commands: Commands) -> None:
    """Add the command."""
    text = "random poses that the robot can reach inside its limits"
    parser = commands.add_parser(
        "sample",
        help=text,
        description=f"{text}. The same seed gives the same poses.",
        epilog=example("ikgrad sample --robot panda --count 1000 --seed 0 -o poses.csv --joints q.csv"),
    )
    add_robot_options(parser)
    parser.add_argument("--count", type=count, required=True, metavar="N", help="how many poses")
    parser.add_argument("--seed", type=seed, default=0, help="of the random numbers (default 0)")
    parser.add_argument("--sobol", action="store_true", help="a scrambled Sobol sequence: more even than random")
    parser.add_argument(
        "-o", "--output", required=True, metavar="POSES", help="pose file: CSV, NPY, NPZ or Parquet, by suffix"
    )
    parser.add_argument("--joints", metavar="JOINTS", help="also write the configurations: CSV, NPZ or Parquet")
    parser.add_argument("--force", action="store_true", help="overwrite existing outputs")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the files."""
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
