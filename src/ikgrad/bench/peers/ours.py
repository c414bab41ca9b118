"""ikgrad itself, through its public functions."""

from __future__ import annotations

import numpy as np
import torch

import ikgrad
from ikgrad.bench.peers.base import Peer, Question
from ikgrad.kinematics import forward_kinematics, jacobian
from ikgrad.robot import Robot
from ikgrad.solvers.solve import solve_ik


class Ikgrad(Peer):
    """`solve_ik`, `forward_kinematics` and `jacobian` with their defaults."""

    name = "ikgrad"
    package = "ikgrad"
    module = "ikgrad"
    jobs = frozenset({"ik", "fk", "fk_backward", "jacobian"})
    batched = True
    settings = "solve_ik, forward_kinematics, jacobian with their defaults"

    @property
    def version(self) -> str:
        """Version of the code that runs."""
        return ikgrad.__version__

    def prepare(self, robot: Robot, question: Question) -> None:
        """Nothing to build."""
        self._robot, self._question = robot, question

    def solve(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """All poses in one call."""
        ask = self._question
        start = None if q0 is None else torch.from_numpy(q0)
        target = torch.from_numpy(np.ascontiguousarray(T))
        found = solve_ik(self._robot, target, q0=start, tol_pos=ask.tol_pos, tol_rot=ask.tol_rot, seed=ask.seed)
        return found.q.numpy()

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """One pose, no batch dimension."""
        ask = self._question
        start = None if q0 is None else torch.from_numpy(q0)
        found = solve_ik(
            self._robot, torch.from_numpy(T), q0=start, tol_pos=ask.tol_pos, tol_rot=ask.tol_rot, seed=ask.seed
        )
        return found.q.numpy()

    def fk(self, q: np.ndarray) -> np.ndarray:
        """All rows in one call."""
        return forward_kinematics(self._robot, torch.from_numpy(q)).numpy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """All rows in one call."""
        return jacobian(self._robot, torch.from_numpy(q)).numpy()

    def fk_backward(self, q: np.ndarray) -> np.ndarray:
        """Loss: the sum of all elements of the poses."""
        leaf = torch.from_numpy(q).requires_grad_()
        forward_kinematics(self._robot, leaf).sum().backward()
        assert leaf.grad is not None
        return leaf.grad.numpy()
