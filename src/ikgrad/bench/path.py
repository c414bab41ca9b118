"""Following paths: every answer is the start of the next pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ikgrad.bench.boxes import solvable_nearby
from ikgrad.bench.ik import Plan, ready, torch_threads, version
from ikgrad.bench.judge import judge
from ikgrad.bench.peers.base import Peer, Question
from ikgrad.bench.peers.ours import Ikgrad
from ikgrad.bench.protocols import Protocol
from ikgrad.bench.race import Advance, Runner, race
from ikgrad.bench.records import Cell
from ikgrad.bench.statistics import Interval, percentile
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot

POINTS = 1000
JUMP = 0.2  # rad or m in one joint from point to point


def bench_paths(
    robot: Robot, protocol: Protocol, plan: Plan, peers: Sequence[Peer], *, advance: Advance = lambda _: None
) -> list[Cell]:
    """Paths that advance together, a point each a call, and path by path.

    A row of the race is a path. ``extra`` holds the largest joint change from a point to the next, of the answers and
    of the path that the poses were made from, how many of the answers' changes are above 0.2 rad, and how many of
    these were avoidable: a solution within 0.2 rad of the last answer exists. (Two branches meet at a singularity;
    whoever takes the other one there may find its end later, at a limit.)
    """
    assert protocol.paths is not None
    q = protocol.paths(robot, plan.rows, POINTS, plan.seed)
    T = forward_kinematics(robot, q)
    cells = []
    for threads in plan.threads:
        question = Question(protocol.tol_pos, protocol.tol_rot, protocol.cap, threads, plan.seed)
        with torch_threads(threads):
            ours = Ikgrad()
            entries: list[tuple[Runner, Peer]] = []
            for peer, batch in ((ours, len(q)), (ours, 1), *((peer, 1) for peer in peers)):
                why = peer.available(robot) or ready(peer, robot, question)
                if why is None and peer is not ours and not _takes_starts(peer):
                    why = "takes no start for a pose"
                if why is not None:
                    cells.append(Cell(robot.name, peer.name, batch, threads, version=version(peer), missing=why))
                    continue
                entries.append((Runner(peer.name, _Follow(peer, q, T, batch), len(q), batch, peer is ours), peer))
            race(
                [runner for runner, _ in entries], rounds=min(plan.rounds, len(q)), budget=plan.seconds, advance=advance
            )
            cells += [_cell(robot, q, T, question, runner, peer, entries[0][0]) for runner, peer in entries]
    return sorted(cells, key=lambda cell: cell.threads)


class _Follow:
    """Work of a race: the points of some paths, one after the other."""

    def __init__(self, peer: Peer, q: Tensor, T: Tensor, batch: int):
        self._peer, self._start = peer, q[:, 0].numpy()
        self._together = batch > 1
        self._ticks = np.ascontiguousarray(T.transpose(0, 1).numpy())  # (points, paths, 4, 4)

    def __call__(self, rows: slice) -> np.ndarray:
        """Joints of these paths: (paths, points * n)."""
        q = self._start[rows]
        answers = []
        if self._together:
            for T in self._ticks:
                found = self._peer.solve(T[rows], q)
                answers.append(found)
                q = np.where(np.isfinite(found), found, q)
        else:
            last = q[0]
            for T in self._ticks:
                found = self._peer.solve_one(T[rows.start], last)
                answers.append(found[None])
                last = np.where(np.isfinite(found), found, last)
        return np.stack(answers, axis=1).reshape(rows.stop - rows.start, -1)


def _takes_starts(peer: Peer) -> bool:
    return peer.name != "pytorch-kinematics"


def _cell(robot: Robot, q: Tensor, T: Tensor, question: Question, runner: Runner, peer: Peer, first: Runner) -> Cell:
    points = q.shape[1]
    rows, flat = runner.gathered(points * robot.dof)
    answers = torch.from_numpy(flat).view(len(rows), points, robot.dof)
    verdict = judge(
        robot,
        answers.flatten(0, 1),
        T[rows].flatten(0, 1),
        tol_pos=question.tol_pos,
        tol_rot=question.tol_rot,
    )
    jumps = answers.diff(dim=1).abs().amax(dim=-1)  # (paths, points - 1)
    path, point = torch.nonzero(jumps > JUMP, as_tuple=True)
    avoidable = solvable_nearby(robot, T[rows][path, point + 1], answers[path, point], JUMP)
    jumps = jumps[jumps.isfinite()]
    return Cell(
        robot.name,
        runner.name,
        runner.batch,
        question.threads,
        version=version(peer),
        rows=len(rows) * points,
        calls=len(runner.calls) * points,
        solved=int(verdict.solved.sum()),
        outside=int((verdict.position_error.isfinite() & ~verdict.inside).sum()),
        median=percentile(runner.calls, 50) / points,
        percentile_95=percentile(runner.calls, 95) / points,
        mean=Interval(*(x / points for x in runner.interval)),
        ratio=runner.ratio_to(first),
        extra={
            "largest_jump": float(jumps.max()) if len(jumps) else float("nan"),
            "jumps_above_0.2": float(len(path)),
            "avoidable_jumps": float(avoidable.sum()),
            "largest_change_of_the_path": float(q[rows].diff(dim=1).abs().max()),
        },
    )
