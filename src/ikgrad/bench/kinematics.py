"""Forward kinematics, its gradient and Jacobians: rows a second in float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ikgrad.bench.ik import PEER_BATCH, Plan, ready, torch_threads, version
from ikgrad.bench.peers.base import Peer, Question, foreign
from ikgrad.bench.peers.ours import Ikgrad
from ikgrad.bench.race import Advance, Runner, race
from ikgrad.bench.records import Cell
from ikgrad.bench.statistics import percentile
from ikgrad.data import sample_configurations
from ikgrad.robot import Robot

JOBS = {"fk": ("fk", "fk_backward"), "jacobian": ("jacobian",)}  # what the commands run
TOLERANCE = 1e-9  # results must agree to this with ours, or the peer is not in the table


class Memory(Peer):
    """No solver: numpy writes as many bytes as the result has, the floor for whatever writes it to memory."""

    name = "memory"
    package = "numpy"
    module = "numpy"
    jobs = frozenset({"fk", "jacobian"})
    batched = True
    settings = "numpy fills a new array of the result's size: the time that writing alone takes, on one thread"

    def prepare(self, robot: Robot, question: Question) -> None:
        """Nothing to build."""
        self._np = foreign("numpy")

    def fk(self, q: np.ndarray) -> np.ndarray:
        """Zeros, written."""
        return np.full((len(q), 4, 4), 0.0)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Zeros, written."""
        return np.full((len(q), 6, q.shape[1]), 0.0)


def bench_kinematics(
    robot: Robot, command: str, plan: Plan, peers: Sequence[Peer], *, advance: Advance = lambda _: None
) -> list[Cell]:
    """The jobs of a command for one robot.

    Args:
        robot: the robot.
        command: fk (with and without backward) or jacobian.
        plan: sizes and budgets.
        peers: whom to compare with.
        advance: called with 1 after every turn.

    Returns:
        A cell for each job, batch size, number of threads and solver, ours first.
    """
    q = np.ascontiguousarray(sample_configurations(robot, plan.rows, seed=plan.seed).numpy())
    cells = []
    for job in JOBS[command]:
        for batch, threads in plan.cells():
            with torch_threads(threads):
                cells += _race(robot, q, job, min(batch, len(q)), threads, plan, (Ikgrad(), *peers), advance)
    return cells


def _race(
    robot: Robot,
    q: np.ndarray,
    job: str,
    batch: int,
    threads: int,
    plan: Plan,
    solvers: Sequence[Peer],
    advance: Advance,
) -> list[Cell]:
    missing = []
    runners: dict[Runner, Peer] = {}
    for peer in (solver for solver in solvers if job in solver.jobs):
        cell = Cell(robot.name, peer.name, batch, threads, job, version=version(peer))
        why = peer.available(robot, job) or ready(peer, robot, Question(threads=threads))
        if why is None and peer.name != Memory.name:
            why = _differs(peer, solvers[0], job, q[:32])
        if why is not None:
            missing.append(replace(cell, missing=why))
            continue
        size = batch if peer.batched else min(batch, PEER_BATCH)
        runners[Runner(peer.name, _work(getattr(peer, job), q), len(q), size, peer is solvers[0])] = peer
    race(list(runners), rounds=min(plan.rounds, len(q)), budget=plan.seconds, advance=advance)
    first = next(iter(runners))
    cells = [
        Cell(
            robot.name,
            runner.name,
            runner.batch,
            threads,
            job,
            version=version(peer),
            rows=len(q) if runner is first else min(len(q), sum(1 for _ in runner.calls) * runner.batch),
            calls=len(runner.calls),
            median=percentile(runner.calls, 50),
            percentile_95=percentile(runner.calls, 95),
            mean=runner.interval,
            ratio=runner.ratio_to(first),
        )
        for runner, peer in runners.items()
    ]
    return cells + missing


def _work(function: Callable[[np.ndarray], np.ndarray], q: np.ndarray) -> Callable[[slice], None]:
    """Results are dropped: keeping them would be timed as well."""

    def work(rows: slice) -> None:
        function(q[rows])

    return work


def _differs(peer: Peer, ours: Peer, job: str, q: np.ndarray) -> str | None:
    worst = float(np.abs(getattr(peer, job)(q) - getattr(ours, job)(q)).max())
    return None if worst <= TOLERANCE else f"its result differs from ours by {worst:.1g}"
