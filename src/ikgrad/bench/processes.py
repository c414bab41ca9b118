"""Whole processes: a million poses through `ikgrad solve`, and the first solve after a start."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from ikgrad.bench.ik import Plan
from ikgrad.bench.judge import judge
from ikgrad.bench.protocols import Protocol
from ikgrad.bench.race import Advance
from ikgrad.bench.records import Cell
from ikgrad.bench.statistics import Interval, median_interval
from ikgrad.data import sample_configurations
from ikgrad.errors import ConfigError
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot

CHUNK = 65_536


class Ended(NamedTuple):
    """What a process left."""

    output: str
    errors: str
    seconds: float
    peak: float  # resident memory [MB]


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
    """
    cells = []
    with tempfile.TemporaryDirectory() as folder:
        poses = Path(folder) / "poses.npy"
        _write_poses(robot, poses, plan)
        for threads in plan.threads:
            output = Path(folder) / f"joints-{threads}.npz"
            begin = time.perf_counter()
            ended = _run(
                ["-c", _COMMAND, "solve", "--robot", source, str(poses), "-o", str(output), "--json"],
                {"OMP_NUM_THREADS": str(threads)},
            )
            took = time.perf_counter() - begin
            rate = float(json.loads(ended.output)["poses_per_second"])
            cells.append(_stream_cell(robot, protocol, plan, threads, poses, output, took, rate, ended.peak))
            advance(1)
    return cells


def _write_poses(robot: Robot, path: Path, plan: Plan) -> None:
    file = np.lib.format.open_memmap(path, mode="w+", dtype=np.float64, shape=(plan.rows, 4, 4))
    q = sample_configurations(robot, plan.rows, seed=plan.seed)
    for first in range(0, plan.rows, CHUNK):
        file[first : first + CHUNK] = forward_kinematics(robot, q[first : first + CHUNK]).numpy()
    file.flush()


def _stream_cell(
    robot: Robot,
    protocol: Protocol,
    plan: Plan,
    threads: int,
    poses: Path,
    output: Path,
    took: float,
    rate: float,
    peak: float,
) -> Cell:
    T = torch.from_numpy(np.load(poses))
    with np.load(output) as file:
        q = torch.from_numpy(file["q"])
    verdict = judge(robot, q, T, tol_pos=protocol.tol_pos, tol_rot=protocol.tol_rot)
    return Cell(
        robot.name,
        "ikgrad",
        plan.rows,
        threads,
        "stream",
        rows=plan.rows,
        calls=1,
        solved=int(verdict.solved.sum()),
        outside=int((~verdict.inside).sum()),
        median=took / plan.rows,
        mean=Interval(took / plan.rows, took / plan.rows, took / plan.rows),
        extra={"peak_memory_mb": peak, "seconds": took, "solve_poses_per_second": rate},
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
    _run(["-c", first], {})  # fills the kernel cache and the system's file cache
    over, alone = [], []
    for _ in range(plan.rows):
        alone.append(_run(["-c", _IMPORT], {}).seconds)
        over.append(_run(["-c", first], {}).seconds - alone[-1])
        advance(1)
    with tempfile.TemporaryDirectory() as folder:
        fresh = {"NUMBA_CACHE_DIR": folder, "XDG_CACHE_HOME": folder}
        ended = _run(["-c", first], fresh)
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


def _run(arguments: list[str], environment: Mapping[str, str]) -> Ended:
    """Run Python with some arguments and more environment variables.

    Raises:
        ConfigError: it failed; the message ends with its last line.
    """
    variables = {**os.environ, "OMP_WAIT_POLICY": "passive", **environment}
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        begin = time.perf_counter()
        process = subprocess.Popen([sys.executable, *arguments], stdout=out, stderr=err, env=variables)
        if hasattr(os, "wait4"):
            _, status, usage = os.wait4(process.pid, 0)  # of this child alone; getrusage would mix all children
            process.returncode = os.waitstatus_to_exitcode(status)
            peak = usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)  # bytes there, kB elsewhere
        else:
            process.wait()
            peak = float("nan")
        took = time.perf_counter() - begin
        out.seek(0)
        err.seek(0)
        message = err.read()
        if process.returncode != 0:
            lines = message.strip().splitlines()
            raise ConfigError(f"a process of the benchmark failed: {lines[-1] if lines else process.returncode}")
        return Ended(out.read(), message, took, peak)
