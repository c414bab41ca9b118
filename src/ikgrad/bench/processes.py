"""Whole processes: a million poses through `ikgrad solve`, and the first solve after a start."""

from __future__ import annotations

import importlib.util
import json
import tempfile
from pathlib import Path

import torch

from ikgrad.bench.ik import Plan
from ikgrad.bench.judge import judge
from ikgrad.bench.protocols import Protocol
from ikgrad.bench.race import Advance
from ikgrad.bench.records import Cell
from ikgrad.bench.statistics import Interval, median_interval
from ikgrad.bench.watch import Ended, run_python
from ikgrad.data import sample_configurations
from ikgrad.files import open_joints, open_poses, pose_writer
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot

CHUNK = 65_536


_COMMAND = "import sys; from ikgrad.cli.main import main; sys.exit(main(sys.argv[1:]))"
_IMPORT = "import torch"
_FIRST = """import torch
import ikgrad as ik
robot = ik.load_robot({robot!r})
T = torch.eye(4, dtype=torch.float64)
T[:3] = torch.tensor({target}, dtype=torch.float64)
assert ik.solve_ik(robot, T).success
"""


def bench_stream(robot: Robot, protocol: Protocol, plan: Plan, *, source: str, advance: Advance) -> list[Cell]:
    """`ikgrad solve` on a file of poses in a process of its own: rate and greatest resident memory.

    Args:
        robot: whose poses.
        protocol: tolerances.
        plan: rows, threads and seed.
        source: what ``--robot`` is given.
        advance: called with 1 after every run.

    Returns:
        A cell for each number of threads and kind of file; Parquet if pyarrow is installed.
    """
    cells = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, (before, after) in file_kinds().items():
            poses = Path(folder) / f"poses{before}"
            with pose_writer(poses) as writer:
                for q in sample_configurations(robot, plan.rows, seed=plan.seed).split(CHUNK):
                    writer.append(forward_kinematics(robot, q))
            for threads in plan.threads:
                output = Path(folder) / f"joints-{threads}{after}"
                ended = run_python(
                    ["-c", _COMMAND, "solve", "--robot", source, str(poses), "-o", str(output), "--json"],
                    {"OMP_NUM_THREADS": str(threads)},
                )
                cells.append(_stream_cell(robot, protocol, plan, f"ikgrad, {kind}", threads, (poses, output), ended))
                advance(1)
    return cells


def file_kinds() -> dict[str, tuple[str, str]]:
    """Kinds of file that can be read and written here, with the suffixes of poses and joints."""
    kinds = {"NPY": (".npy", ".npz")}
    if importlib.util.find_spec("pyarrow") is not None:
        kinds["Parquet"] = (".parquet", ".parquet")
    return kinds


def _stream_cell(
    robot: Robot, protocol: Protocol, plan: Plan, name: str, threads: int, files: tuple[Path, Path], ended: Ended
) -> Cell:
    T = torch.cat([targets.T for targets in open_poses(files[0]).chunks()])
    q = torch.cat(list(open_joints(files[1], robot).chunks()))
    verdict = judge(robot, q, T, tol_pos=protocol.tol_pos, tol_rot=protocol.tol_rot)
    each = ended.seconds / plan.rows
    rate = float(json.loads(ended.output)["poses_per_second"])
    return Cell(
        robot.name,
        name,
        plan.rows,
        threads,
        "stream",
        rows=plan.rows,
        calls=1,
        solved=int(verdict.solved.sum()),
        outside=int((~verdict.inside).sum()),
        median=each,
        mean=Interval(each, each, each),
        extra={"peak_memory_mb": ended.peak, "seconds": ended.seconds, "solve_poses_per_second": rate},
    )


def bench_cold(robot: Robot, plan: Plan, *, source: str, advance: Advance) -> list[Cell]:
    """Fresh processes in turns: `import torch` alone, and load, solve one pose, end; then once without a kernel cache.

    Args:
        robot: for its name and a pose.
        plan: ``rows`` processes of each kind.
        source: what `load_robot` is given.
        advance: called with 1 after every pair of processes.

    Returns:
        Two cells: kernels cached, and compiling (in an empty cache folder).
    """
    target = forward_kinematics(robot, sample_configurations(robot, 1, seed=plan.seed))[0, :3].tolist()
    first = _FIRST.format(robot=source, target=target)
    run_python(["-c", first])  # fills the kernel cache and the system's file cache
    over, alone = [], []
    for _ in range(plan.rows):
        alone.append(run_python(["-c", _IMPORT]).seconds)
        over.append(run_python(["-c", first]).seconds - alone[-1])
        advance(1)
    with tempfile.TemporaryDirectory() as folder:
        fresh = {"NUMBA_CACHE_DIR": folder, "XDG_CACHE_HOME": folder}
        ended = run_python(["-c", first], fresh)
        compiling = ended.seconds - median_interval(alone).value
        advance(1)
    interval = median_interval(over)
    return [
        Cell(
            robot.name,
            "ikgrad, kernels cached",
            1,
            1,
            "cold",
            rows=plan.rows,
            calls=plan.rows,
            mean=interval,
            median=interval.value,
            extra={"import_torch_seconds": median_interval(alone).value},
        ),
        Cell(
            robot.name,
            "ikgrad, compiling",
            1,
            1,
            "cold",
            rows=1,
            calls=1,
            mean=Interval(compiling, compiling, compiling),
            median=compiling,
            extra={
                "import_torch_seconds": median_interval(alone).value,
                "says_so": float("compiling" in ended.errors),
            },
        ),
    ]
