"""``ikgrad solve``: joint values for a file of poses."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.folders import FOLDER_OPTIONS, add_folder_options, refuse_options
from ikgrad.cli.parsing import Commands, add_robot_options, count, example, mask, positive, seed
from ikgrad.cli.solve_report import bad_targets, summary_document, summary_rows
from ikgrad.cli.terminal import Progress, duration, print_json, print_table
from ikgrad.errors import ConfigError, DataError

if TYPE_CHECKING:
    import numpy as np

    from ikgrad.cli.solve_job import Job
    from ikgrad.jobs.answers import Summary

SOLVERS = {"lm": "LevenbergMarquardt", "apps": "Apps", "newton": "NewtonRaphson", "puma560": "Puma560ClosedForm"}
# The slow methods are interrupted at a smaller loss.
CHUNK = {"lm": 16_384, "apps": 2_048, "newton": 2_048, "puma560": 16_384}

DESCRIPTION = """\
inverse kinematics for a file of poses: one row of joint values per pose, with errors, success and reason.

POSES is CSV or Parquet with the columns x_m,y_m,z_m,qw,qx,qy,qz, or NPY or NPZ with (N, 4, 4) matrices.
A pose that cannot be solved is no error: its row says why (unreachable, joint_limits, no_convergence,
invalid_target) and the exit status is 0. The exit status is 2 for a mistake and 130 for Ctrl-C, which keeps
what is finished in OUTPUT.partial; the same command with --resume goes on from there.

A folder of Parquet files as POSES gives a folder of Parquet files of the same names as JOINTS, by as many processes
as there are cores, by a Ray cluster, or by the shards of a job array. Finished files are kept whatever happens."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "solve",
        help="inverse kinematics for a file of poses",
        description=DESCRIPTION,
        epilog=example(
            "ikgrad solve --robot panda poses.csv -o joints.csv\n"
            "ikgrad solve --robot arm.urdf --tip tool0 poses.npy -o joints.parquet --solutions 4 --plot report.png\n"
            "ikgrad solve --robot panda poses/ -o joints/"
        ),
    )
    add_robot_options(parser)
    parser.add_argument("poses", metavar="POSES", help="pose file: CSV, NPY, NPZ or Parquet; or a folder")
    parser.add_argument(
        "-o", "--output", required=True, metavar="JOINTS", help="CSV, NPZ or Parquet, by suffix; or a folder"
    )
    _add_method(parser)
    parser.add_argument("--repair", action="store_true", help="replace what is no rotation by the nearest rotation")
    parser.add_argument("--force", action="store_true", help="overwrite existing outputs")
    parser.add_argument("--resume", action="store_true", help="go on with a run that was stopped")
    parser.add_argument(
        "--chunk", type=count, metavar="ROWS", help="rows solved and kept at a time (16384; apps: 2048)"
    )
    parser.add_argument("--plot", metavar="FILE", help="also draw errors, steps and reasons (PNG or SVG)")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")
    add_folder_options(parser)
    parser.set_defaults(run=run)


def _add_method(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--q0", metavar="FILE", help="joint file to start from and stay near: a row per pose, or one")
    parser.add_argument("--solver", choices=list(SOLVERS), default="lm", help="lm (default), apps, newton, puma560")
    parser.add_argument("--solutions", type=count, default=1, metavar="K", help="different solutions per pose")
    parser.add_argument("--tol-pos", type=positive, default=1e-6, metavar="M", help="largest error [m] (1e-6)")
    parser.add_argument("--tol-rot", type=positive, default=1e-6, metavar="RAD", help="largest error [rad] (1e-6)")
    parser.add_argument("--no-limits", action="store_true", help="ignore the joint limits")
    text = "which of x,y,z,rx,ry,rz count, along the target's axes; 1,1,1,0,0,0 is position only"
    parser.add_argument("--mask", type=mask, metavar="1,1,1,0,0,0", help=text)
    parser.add_argument("--seed", type=seed, default=0, help="of the random restarts (default 0)")


def run(args: argparse.Namespace) -> int:
    """Solve the file or the folder, write the joints, print the summary."""
    poses = Path(args.poses)
    if poses.is_dir():
        from ikgrad.cli import solve_folder

        return solve_folder.run(args, _settings(args))
    if not poses.exists() and not poses.suffix:
        raise DataError(f"{poses}: no such file or folder")
    refuse_options(args, FOLDER_OPTIONS, "is for a folder of poses, and POSES is a file")
    output = _check_places(args)
    from ikgrad.cli.solve_job import keeping
    from ikgrad.files import PartialRun

    job = _job(args, output)
    parts = PartialRun.open(output, job.manifest(), resume=args.resume, force=args.force)
    arrays: dict[str, np.ndarray] | None = {} if args.plot else None
    begin = time.perf_counter()
    job.warm_up()
    with keeping(parts, keep_on_error=False), Progress("solve", job.poses.total, "poses") as progress:
        job.solve(parts, progress)
        rate = progress.rate
    with keeping(parts, keep_on_error=True):
        summary = job.assemble(parts, output, force=args.force, keep=arrays)
    parts.discard()
    if arrays is not None:
        _plot(arrays, args, job)
    _report(args, job, summary, rate, time.perf_counter() - begin)
    return 0


def _check_places(args: argparse.Namespace) -> Path:
    """All that can be wrong about outputs, before any work is done."""
    from ikgrad.files.joints import OUT_SUFFIXES
    from ikgrad.files.places import check_output

    inputs = [args.poses] + ([args.q0] if args.q0 else [])
    output = check_output(args.output, OUT_SUFFIXES, force=args.force, inputs=inputs)
    if args.plot:
        plot = check_output(args.plot, (".png", ".svg"), force=args.force, inputs=inputs)
        if plot.absolute() == output.absolute():
            raise ConfigError("-o and --plot name the same file")
    return output


def _job(args: argparse.Namespace, output: Path) -> Job:
    import ikgrad as ik
    from ikgrad.cli.solve_job import Job
    from ikgrad.files import open_joints, open_poses
    from ikgrad.files.joints import check_joint_names

    robot = ik.load_robot(args.robot, base=args.base, tip=args.tip)
    check_joint_names(output, robot)
    return Job(
        robot=robot,
        poses=open_poses(args.poses, repair=args.repair),
        q0=open_joints(args.q0, robot) if args.q0 else None,
        settings=_settings(args),
        chunk=args.chunk or max(1, CHUNK[args.solver] // args.solutions),
    )


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `ikgrad.solve_ik`."""
    import ikgrad as ik

    return {
        "solver": getattr(ik, SOLVERS[args.solver])(),
        "solutions": args.solutions,
        "tol_pos": args.tol_pos,
        "tol_rot": args.tol_rot,
        "limits": not args.no_limits,
        "mask": args.mask,
        "seed": args.seed,
    }


def _plot(arrays: dict[str, np.ndarray], args: argparse.Namespace, job: Job) -> None:
    from ikgrad.plots import save_figure, solve_summary

    title = f"{job.robot.name}: {job.poses.total:,} poses, {SOLVERS[args.solver]}"
    errors = arrays["position_error_m"], arrays["rotation_error_rad"]
    figure = solve_summary(*errors, arrays["steps"], arrays["reason"], title=title)
    save_figure(figure, args.plot, force=args.force)


def _report(args: argparse.Namespace, job: Job, summary: Summary, rate: float, seconds: float) -> None:
    if args.json:
        about = {"robot": job.robot.name, "solver": args.solver, **summary_document(summary)}
        speed = {"poses_per_second": rate, "seconds": seconds}
        print_json({**about, **speed, "output": args.output, "plot": args.plot})
        return
    rows = summary_rows(summary)
    rows += [["speed", f"{rate:,.0f} poses/s"], ["time", duration(seconds)], ["written", args.output]]
    if args.plot:
        rows.append(["drawn", args.plot])
    print_table(f"ikgrad solve: {job.robot.name}, {args.solver}", ["", ""], rows)
    for line in bad_targets(summary, args.repair):
        print(line)
