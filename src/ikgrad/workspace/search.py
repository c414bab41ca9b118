"""One orientation over all cells: what is out of reach for certain, what is reached, and by which joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from ikgrad import engine
from ikgrad.engine.dexterity import dexterity
from ikgrad.engine.poses import measure
from ikgrad.robot import Robot
from ikgrad.solvers.compiled import TABLE_STARTS
from ikgrad.solvers.variety import DIFFERENT
from ikgrad.workspace.bounds import Reach, Span, reach
from ikgrad.workspace.flood import flood
from ikgrad.workspace.grid import Grid

_ROWS = 65_536  # poses at a time: 8 MB of matrices
_SLACK = 1e-9  # of the bounds, for rounding
_SPREAD = 0x9E3779B97F4A7C15  # keeps the seeds of several searches apart


class Layer(NamedTuple):
    """One orientation."""

    wanted: np.ndarray  # (C,) bool, False where the pose is unreachable for certain
    reached: np.ndarray  # (C,) bool
    q: np.ndarray  # (C, n) joints where it is reached


@dataclass(frozen=True, eq=False)
class Search:
    """A question about every cell.

    Attributes:
        robot: the robot.
        grid: the cells.
        mask: (6,) ones and zeros as in `ikgrad.solve_ik`.
        starts: of the solver for a pose, before neighbours help.
        tol_pos: [m]
        tol_rot: [rad]
        seed: of random starts.
    """

    robot: Robot
    grid: Grid
    mask: np.ndarray
    starts: int
    tol_pos: float
    tol_rot: float
    seed: int

    @property
    def full(self) -> bool:
        """True if all six directions count."""
        return bool((self.mask == 1).all())

    def layer(self, rotation: np.ndarray) -> Layer:
        """Search all cells for one orientation (3, 3)."""
        cells, n = len(self.grid), self.robot.dof
        wanted = self._wanted(rotation)
        reached, q = np.zeros(cells, dtype=bool), np.zeros((cells, n))
        rows = np.flatnonzero(wanted)
        reached[rows], q[rows] = self.solve(rows, rotation, None, starts=self.starts)
        flood(reached, q, wanted, self.grid.neighbours, lambda at, start: self.solve(at, rotation, start, starts=1))
        return Layer(wanted, reached, q)

    def _wanted(self, rotation: np.ndarray) -> np.ndarray:
        """(C,) False where the tip, or the wrist that the full pose fixes, is farther or nearer than it can be."""
        bounds: Reach = reach(self.robot)
        tip = self.grid.centres - bounds.shoulder
        wanted = _inside(tip, bounds.tip, self.tol_pos)
        if self.full:
            T_wrist = np.linalg.inv(self.robot.detach().tables().tool.numpy())
            room = self.tol_pos + self.tol_rot * float(np.linalg.norm(T_wrist[:3, 3]))
            wanted &= _inside(tip + rotation @ T_wrist[:3, 3], bounds.wrist, room)
        return wanted

    def solve(
        self, cells: np.ndarray, rotation: np.ndarray, q0: np.ndarray | None, *, starts: int, fresh: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve poses and measure the answers by forward kinematics.

        Args:
            cells: (B,) numbers of the cells.
            rotation: (3, 3) of all of them.
            q0: (B, n) first starts, or None.
            starts: starts a pose.
            fresh: above 0, the starts are random ones that no other number gives.

        Returns:
            (B,) bool, reached; (B, n) joints.
        """
        chain, threads = engine.pack(self.robot.detach()), torch.get_num_threads()
        reached, q = np.empty(len(cells), dtype=bool), np.empty((len(cells), self.robot.dof))
        guesses = 0 if fresh else TABLE_STARTS
        for rows in _pieces(len(cells)):
            T = self._poses(cells[rows], rotation)
            found = engine.solve(
                chain, T, None if q0 is None else q0[rows], weights=self.mask, tol_pos=self.tol_pos,
                tol_rot=self.tol_rot, max_starts=starts, seed=(self.seed + fresh * _SPREAD) % 2**63,
                guesses=guesses, threads=threads,
            )  # fmt: skip
            q[rows] = found.q
            verdict = measure(
                engine.fk(chain, found.q, threads=threads), T, np.ones(len(T), dtype=bool), found.q,
                q_min=chain.q_min, q_max=chain.q_max, mask=self.mask, tol_pos=self.tol_pos, tol_rot=self.tol_rot,
                threads=threads,
            )  # fmt: skip
            reached[rows] = verdict.success
        return reached, q

    def _poses(self, cells: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        T = np.zeros((len(cells), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotation, self.grid.centres[cells], 1.0
        return T

    def dexterity(self, q: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """(B, 2) condition number and manipulability at joints that reach this orientation.

        The rows of the Jacobian are those that count, along the target's own axes as the mask has it, with lengths in
        units of `Robot.typical_length`.
        """
        chain, threads = engine.pack(self.robot.detach()), torch.get_num_threads()
        turn = np.kron(np.eye(2), rotation.T)
        turn[:3] /= self.robot.typical_length
        rows, out = turn[self.mask == 1], np.empty((len(q), 2))
        for piece in _pieces(len(q)):
            J = engine.jacobian(chain, q[piece], threads=threads)
            out[piece] = dexterity(J, rows, threads=threads)
        return out


def _inside(step: np.ndarray, span: Span, room: float) -> np.ndarray:
    distance = np.linalg.norm(step, axis=1)
    return (distance <= span.most * (1 + _SLACK) + room) & (distance >= span.least * (1 - _SLACK) - room)


def _pieces(rows: int) -> Iterator[slice]:
    for first in range(0, rows, _ROWS):
        yield slice(first, min(first + _ROWS, rows))


def distinct(search: Search, cells: np.ndarray, rotation: np.ndarray, q: np.ndarray, searches: int) -> np.ndarray:
    """Count different solutions: the one known, and those that more random starts find.

    Two are the same if no joint differs by `DIFFERENT` or more; whole turns do not count.

    Args:
        search: the question.
        cells: (B,) cells that are reached.
        rotation: (3, 3)
        q: (B, n) a solution of each.
        searches: further starts, one solution each at most.

    Returns:
        (B,) int64, at least 1.
    """
    periodic = search.robot.periodic.numpy()
    known = np.full((searches + 1, *q.shape), math.inf)
    known[0] = q
    count = np.ones(len(cells), dtype=np.int64)
    for k in range(searches):
        met, joints = search.solve(cells, rotation, None, starts=1, fresh=k + 1)
        for before in range(int(count.max(initial=0))):
            change = joints - known[before]
            there = np.isfinite(change).all(axis=1)
            change[~there] = 2 * DIFFERENT
            turns = 2 * math.pi * np.round(change / (2 * math.pi))
            met &= (np.abs(np.where(periodic, change - turns, change)) >= DIFFERENT).any(axis=1)
        at = np.flatnonzero(met)
        known[count[at], at] = joints[at]
        count[at] += 1
    return count
