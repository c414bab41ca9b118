"""``ikgrad fk``: poses of joint values, one or a file of them."""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, add_robot_options, example, numbers
from ikgrad.cli.robots import joint_list
from ikgrad.cli.terminal import Progress, note, print_json
from ikgrad.errors import ConfigError

if TYPE_CHECKING:
    from torch import Tensor

    from ikgrad.files import JointFile
    from ikgrad.robot import Robot

CHUNK = 16_384


def add(commands: Commands) -> None:
    """Add the command."""
    text = "forward kinematics: the tip's pose for joint values"
    parser = commands.add_parser(
        "fk",
        help=text,
        description=f"{text}. One pose is printed; a file of joint values gives a file of poses, or CSV on stdout.",
        epilog=example(
            "ikgrad fk --robot ur5e --q 0,-90,90,0,45,0 --deg\nikgrad fk --robot panda joints.csv -o poses.npz"
        ),
    )
    add_robot_options(parser)
    parser.add_argument("joints", nargs="?", metavar="JOINTS", help="joint file: CSV, NPY, NPZ or Parquet")
    parser.add_argument("--q", type=numbers, metavar="Q1,Q2,...", help="one configuration [rad, or m for slides]")
    parser.add_argument("--deg", action="store_true", help="the angles are given in degrees")
    parser.add_argument("-o", "--output", metavar="POSES", help="pose file: CSV, NPY, NPZ or Parquet")
    parser.add_argument("--force", action="store_true", help="overwrite an existing output")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print one pose, or compute a file of them."""
    from ikgrad.files import check_output, open_joints
    from ikgrad.files.writers import SUFFIXES
    from ikgrad.robot import load_robot

    if (args.q is None) == (args.joints is None):
        raise ConfigError("fk needs either --q Q1,Q2,... or a file of joint values")
    if args.output is not None:
        check_output(args.output, SUFFIXES, force=args.force, inputs=[args.joints] if args.joints else [])
    robot = load_robot(args.robot, base=args.base, tip=args.tip)
    if args.q is not None:
        return _one(args, robot)
    joints = open_joints(args.joints, robot)
    if args.output is not None:
        return _to_file(args, robot, joints)
    return _to_stdout(args, robot, joints)


def _radians(args: argparse.Namespace, robot: Robot, q: Tensor) -> Tensor:
    return q.where(~robot.revolute, q.deg2rad()) if args.deg else q


def _one(args: argparse.Namespace, robot: Robot) -> int:
    import torch

    from ikgrad.files import pose_writer
    from ikgrad.kinematics import forward_kinematics
    from ikgrad.rotations import quat_wxyz_from_matrix

    if len(args.q) != robot.dof:
        raise ConfigError(f"--q: expected {robot.dof} numbers ({joint_list(robot)}), got {len(args.q)}")
    q = _radians(args, robot, torch.tensor(args.q, dtype=torch.float64))
    for variable, value in zip(robot.variables, q.tolist(), strict=True):
        if not variable.q_min <= value <= variable.q_max:
            limits = f"{variable.q_min:.6g} to {variable.q_max:.6g}"
            note(f"note: {variable.name} = {value:.6g} is outside its limits {limits}")
    T = forward_kinematics(robot, q)
    if args.output is not None:
        with pose_writer(args.output, force=args.force) as writer:
            writer.append(T[None])
    xyz, quat_wxyz = T[:3, 3].tolist(), quat_wxyz_from_matrix(T[:3, :3]).tolist()
    if args.json:
        document = {"robot": robot.name, "base": robot.base, "tip": robot.tip, "q": q.tolist()}
        print_json({**document, "pose": T.tolist(), "xyz_m": xyz, "quat_wxyz": quat_wxyz})
        return 0
    print(f"{robot.name}: pose of {robot.tip} in {robot.base}")
    for row in T.tolist():
        print("  " + " ".join(f"{value + 0.0:13.9f}" for value in row))
    print("xyz [m]    " + " ".join(f"{value + 0.0:13.9f}" for value in xyz))
    print("quat_wxyz  " + " ".join(f"{value + 0.0:13.9f}" for value in quat_wxyz))
    return 0


def _to_file(args: argparse.Namespace, robot: Robot, joints: JointFile) -> int:
    from ikgrad.files import pose_writer
    from ikgrad.kinematics import forward_kinematics

    done = 0
    with pose_writer(args.output, force=args.force) as writer, Progress("fk", joints.total, "poses") as progress:
        for q in joints.chunks(CHUNK):
            writer.append(forward_kinematics(robot, _radians(args, robot, q)))
            progress.advance(len(q))
            done += len(q)
    if args.json:
        print_json({"robot": robot.name, "poses": done, "output": str(Path(args.output))})
    else:
        print(f"{done:,} poses of {robot.name} -> {args.output}")
    return 0


def _to_stdout(args: argparse.Namespace, robot: Robot, joints: JointFile) -> int:
    from ikgrad.files.poses import COLUMNS, pose_columns
    from ikgrad.kinematics import forward_kinematics

    table = csv.writer(sys.stdout, lineterminator="\n")
    collected: list[dict[str, float]] = []
    if not args.json:
        table.writerow(COLUMNS)
    for q in joints.chunks(CHUNK):
        columns = pose_columns(forward_kinematics(robot, _radians(args, robot, q)))
        rows = list(zip(*(column.tolist() for column in columns.values()), strict=True))
        if args.json:
            collected += [dict(zip(COLUMNS, row, strict=True)) for row in rows]
        else:
            table.writerows(rows)
    if args.json:
        print_json({"robot": robot.name, "base": robot.base, "tip": robot.tip, "poses": collected})
    return 0
