"""ssik: every branch of six- and seven-joint arms by closed forms and elimination, a pose a call (C++ inside)."""

from __future__ import annotations

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, UnsupportedError, check_same_robot, foreign
from ikgrad.bench.peers.chain import z_chain
from ikgrad.robot import Robot


class Ssik(Peer):
    """``Manipulator.solve`` for one solution inside the limits."""

    name = "ssik"
    package = "ssik"
    module = "ssik"
    settings = "Manipulator.from_transforms, solve(max_solutions=1, respect_limits=True, enumerate_windings=False)"

    def check(self, robot: Robot) -> None:
        """Six or seven turning joints."""
        chain = z_chain(robot)
        if len(chain.origins) not in (6, 7) or chain.slides.any():
            raise UnsupportedError("only six or seven turning joints")

    def prepare(self, robot: Robot, question: Question) -> None:
        """From the transforms of our tables."""
        ssik = foreign("ssik")
        chain = z_chain(robot)
        transforms = np.concatenate([chain.origins, chain.tool[None]])
        limits = np.stack([chain.q_min, chain.q_max], axis=1)
        try:
            self._arm = ssik.Manipulator.from_transforms(transforms, limits=limits)
        except (ValueError, NotImplementedError) as error:
            raise UnsupportedError(str(error).splitlines()[0]) from error
        self._arm.prepare()
        self._middle = limits.mean(axis=1)
        check_same_robot(self, robot)

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """Seeded in any case: without a seed seven joints take ten times as long."""
        seed = self._middle if q0 is None else q0
        found = self._arm.solve(T, max_solutions=1, q_seed=seed, enumerate_windings=False)
        return np.asarray(found[0].q) if found else np.full(len(seed), np.nan)

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One call a row; only to see that it is the same robot."""
        return np.stack([self._arm.fk(row) for row in q])
