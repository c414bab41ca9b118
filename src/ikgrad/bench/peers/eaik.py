"""EAIK: closed forms for six-joint arms that have one, all solutions of many poses in one C++ call."""

from __future__ import annotations

from typing import Any

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, UnsupportedError, check_same_robot, foreign
from ikgrad.bench.peers.chain import ZChain, z_chain, zero_axes
from ikgrad.robot import Robot


class Eaik(Peer):
    """``HPRobot.IK_batched`` and the first of the solutions that is inside the limits."""

    name = "eaik"
    package = "EAIK"
    module = "eaik"
    batched = True
    settings = "HPRobot.IK_batched; picking a solution inside the limits counts as its time"

    def check(self, robot: Robot) -> None:
        """Six turning joints, of a family that it knows."""
        chain = z_chain(robot)
        if len(chain.origins) != 6 or chain.slides.any():
            raise UnsupportedError("only six turning joints here")
        if self.installed() and not _build(chain).hasKnownDecomposition():
            raise UnsupportedError("no closed form for this arm")

    def prepare(self, robot: Robot, question: Question) -> None:
        """Axes and steps between them at q = 0; its tip has no rotation of its own, so targets are turned."""
        chain = z_chain(robot)
        self._robot, self._threads = _build(chain), question.threads
        self._turn = np.eye(4)
        self._turn[:3, :3] = zero_axes(chain)[2].T
        self._low, self._high = chain.q_min, chain.q_max
        check_same_robot(self, robot)

    def solve(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """All poses in one call."""
        answers = self._robot.IK_batched(T @ self._turn, self._threads)
        sets = [np.asarray(answer.Q, dtype=np.float64).reshape(-1, 6) for answer in answers]
        exact = ~np.concatenate([np.asarray(answer.is_LS, dtype=bool).reshape(-1) for answer in answers])
        counts = np.array([len(q) for q in sets])
        q = np.concatenate(sets)
        row = np.repeat(np.arange(len(T)), counts)
        turn = 2 * np.pi
        q = q + turn * np.where(q < self._low, np.ceil((self._low - q) / turn), 0)
        q = q + turn * np.where(q > self._high, np.floor((self._high - q) / turn), 0)
        inside = ((q >= self._low) & (q <= self._high)).all(axis=1)
        result = np.full((len(T), 6), np.nan)
        for choice in (inside, inside & exact):  # what is written last wins; some "solutions" are nearest misses
            result[row[choice]] = q[choice]
        return result

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One call a row; only to see that it is the same robot."""
        return np.stack([self._robot.fwdKin(row) @ self._turn.T for row in q])


def _build(chain: ZChain) -> Any:
    axes, steps, _ = zero_axes(chain)
    return foreign("eaik.IK_HP").HPRobot(axes, steps)
