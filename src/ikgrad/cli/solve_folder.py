"""``ikgrad solve`` where POSES is a folder of partitions."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ikgrad.cli.folders import check_folder, refuse_options, run_folders
from ikgrad.cli.solve_report import bad_targets, summary_document, summary_rows
from ikgrad.cli.terminal import print_json, print_table


def run(args: argparse.Namespace, settings: dict[str, Any]) -> int:
    """Solve the folder.

    Args:
        args: of the command.
        settings: keyword arguments of `ikgrad.solve_ik`.
    """
    refuse_options(args, ["q0", "plot", "chunk"], "is for a single file of poses, and POSES is a folder")
    poses = Path(args.poses)
    output = check_folder(args.output, [poses])
    from ikgrad.files.joints import check_joint_names
    from ikgrad.jobs.answers import Summary
    from ikgrad.jobs.manifest import summary_of
    from ikgrad.jobs.solving import SolveTask
    from ikgrad.robot import load_robot

    robot = load_robot(args.robot, base=args.base, tip=args.tip)
    check_joint_names(output.path, robot, advice="solve its files one by one, into .npz files")
    task = SolveTask(robot, poses.absolute(), output.absolute(), settings, args.repair)
    done = run_folders(args, "solve", task, [(output, task.job())])
    summary = summary_of(done.records) or Summary(args.solutions)
    if args.json:
        about = {"robot": robot.name, "solver": args.solver, **summary_document(summary)}
        print_json({**about, **done.document(), "output": args.output})
        return 0
    rows = [*summary_rows(summary), *done.rows(), *done.end_rows(args.output)]
    print_table(f"ikgrad solve: {robot.name}, {args.solver}", ["", ""], rows)
    for line in bad_targets(summary, args.repair):
        print(line)
    return 0
