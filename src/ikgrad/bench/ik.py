"""IK in batches or one by one: ours and the peers in turns on the same poses, everybody judged alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ikgrad.bench.judge import judge
from ikgrad.bench.peers.base import Peer, Question, UnsupportedError
from ikgrad.bench.peers.ours import Ikgrad
from ikgrad.bench.protocols import Protocol
from ikgrad.bench.race import Advance, Runner, race
from ikgrad.bench.records import Cell
from ikgrad.bench.statistics import Interval, percentile
from ikgrad.robot import Robot
from ikgrad.solvers.solve import solve_ik

PEER_BATCH = 1000  # poses a call for peers that take many


@dataclass(frozen=True)
class Plan:
    """What a run is made of, apart from robots.

    Attributes:
        rows: poses.
        batches: poses a call of ours; 0 stands for all of them.
        threads: numbers of threads.
        rounds: turns of each solver.
        seconds: time for each peer, all rounds together; ours does every pose whatever it takes.
        seed: of the poses and of random starts.
    """

    rows: int
    batches: tuple[int, ...] = (0,)
    threads: tuple[int, ...] = (1,)
    rounds: int = 9
    seconds: float = 20.0
    seed: int = 0

    def cells(self) -> Iterator[tuple[int, int]]:
        """Batch size and threads of every race."""
        for batch in self.batches:
            for threads in self.threads:
                yield batch or self.rows, threads

    def turns(self, solvers: int) -> int:
        """Turns of one robot, for a progress bar."""
        return len(self.batches) * len(self.threads) * min(self.rounds, self.rows) * solvers


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """This many threads for torch, and so for ours."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def bench_ik(
    robot: Robot, protocol: Protocol, plan: Plan, peers: Sequence[Peer], *, advance: Advance = lambda _: None
) -> list[Cell]:
    """All races of one robot.

    Args:
        robot: whose poses.
        protocol: one that makes poses.
        plan: sizes and budgets.
        peers: whom to compare with; those that cannot do this robot get a cell that says why.
        advance: called with 1 after every turn.

    Returns:
        A cell for each batch size, number of threads and solver, ours first.
    """
    assert protocol.make is not None
    T = protocol.make(robot, plan.rows, plan.seed)
    cells = []
    for batch, threads in plan.cells():
        question = Question(protocol.tol_pos, protocol.tol_rot, protocol.cap, threads, plan.seed)
        with torch_threads(threads):
            cells += _race(robot, T, protocol, replace(plan, batches=(batch,)), question, peers, advance)
    return cells


def _race(
    robot: Robot,
    T: Tensor,
    protocol: Protocol,
    plan: Plan,
    question: Question,
    peers: Sequence[Peer],
    advance: Advance,
) -> list[Cell]:
    ours = Ikgrad()
    batch = 1 if protocol.one_by_one else min(plan.batches[0], len(T))
    missing = []
    runners: dict[Runner, Peer] = {}
    for peer in (ours, *peers):
        why = peer.available(robot, "ik")
        if why is None:
            why = ready(peer, robot, question)
        if why is not None:
            missing.append(Cell(robot.name, peer.name, batch, question.threads, version=version(peer), missing=why))
            continue
        size = batch if peer is ours else min(batch, PEER_BATCH) if peer.batched else 1
        runners[Runner(peer.name, _work(peer, robot, T, protocol, size), len(T), size, peer is ours)] = peer
    race(list(runners), rounds=min(plan.rounds, len(T)), budget=plan.seconds, advance=advance)
    first = next(iter(runners))
    cells = [_cell(robot, T, protocol, question, runner, peer, first) for runner, peer in runners.items()]
    cells[0] = replace(cells[0], reasons=reasons(robot, T, question, protocol) if not protocol.one_by_one else {})
    return cells + missing


def ready(peer: Peer, robot: Robot, question: Question) -> str | None:
    """Prepare a peer; why it cannot, or None."""
    try:
        peer.prepare(robot, question)
    except UnsupportedError as error:
        return str(error)
    return None


def version(peer: Peer) -> str:
    """Version of an installed peer, else nothing."""
    return peer.version if peer.installed() else ""


def _work(peer: Peer, robot: Robot, T: Tensor, protocol: Protocol, size: int) -> Callable[[slice], np.ndarray]:
    poses = T.numpy()
    start: np.ndarray | None = None
    if protocol.from_middle:
        low, high = robot.sampling_range
        start = ((low + high) / 2).numpy()

    def one(rows: slice) -> np.ndarray:
        return peer.solve_one(poses[rows.start], start)[None]

    def many(rows: slice) -> np.ndarray:
        part = poses[rows]
        return peer.solve(part, None if start is None else np.broadcast_to(start, (len(part), len(start))).copy())

    return one if size == 1 else many


def _cell(
    robot: Robot, T: Tensor, protocol: Protocol, question: Question, runner: Runner, peer: Peer, first: Runner
) -> Cell:
    rows, q = runner.gathered(robot.dof)
    verdict = judge(robot, torch.from_numpy(q), T[rows], tol_pos=protocol.tol_pos, tol_rot=protocol.tol_rot)
    solved, late = verdict.solved, 0
    if protocol.cap is not None:
        slow = torch.zeros(len(T), dtype=torch.bool)
        for begin, end, took in runner.took:
            slow[begin:end] = took / (end - begin) > protocol.cap
        late = int((solved & slow[rows]).sum())
        solved = solved & ~slow[rows]
    answered = verdict.position_error.isfinite()
    errors = {}
    for part in (50, 95, 99):
        errors[f"position_mm_p{part}"] = 1e3 * percentile(verdict.position_error.numpy(), part)
        errors[f"rotation_deg_p{part}"] = float(np.degrees(percentile(verdict.rotation_error.numpy(), part)))
    return Cell(
        robot.name,
        runner.name,
        runner.batch,
        question.threads,
        version=version(peer),
        rows=len(rows),
        calls=len(runner.calls),
        solved=int(solved.sum()),
        outside=int((answered & ~verdict.inside).sum()),
        late=None if protocol.cap is None else late,
        median=percentile(runner.calls, 50),
        percentile_95=percentile(runner.calls, 95),
        mean=runner.interval,
        ratio=runner.ratio_to(first) if runner is not first else Interval(1.0, 1.0, 1.0),
        errors=errors,
    )


def reasons(robot: Robot, T: Tensor, question: Question, protocol: Protocol) -> dict[str, int]:
    """What our own solver says about the rows (once more, not timed): table material, no evidence."""
    part = solve_ik(robot, T, tol_pos=protocol.tol_pos, tol_rot=protocol.tol_rot, seed=question.seed)
    return part.counts()
