"""Pinocchio: C++ rigid-body algorithms; forward kinematics and Jacobian, a row a call.

It has no IK solver of its own, and a loop of ours over its functions would say nothing about it.
"""

from __future__ import annotations

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, check_same_robot, foreign
from ikgrad.bench.peers.chain import urdf_text, z_chain
from ikgrad.robot import Robot


class Pinocchio(Peer):
    """``framesForwardKinematics`` and ``computeFrameJacobian`` from a Python loop."""

    name = "pinocchio"
    package = "pin"
    module = "pinocchio"
    jobs = frozenset({"fk", "jacobian"})
    settings = "framesForwardKinematics, computeFrameJacobian (LOCAL_WORLD_ALIGNED), a Python loop over the rows"

    def check(self, robot: Robot) -> None:
        """No coupled joints."""
        z_chain(robot)

    def prepare(self, robot: Robot, question: Question) -> None:
        """From a URDF document written out of our tables."""
        self._pin = foreign("pinocchio")
        self._model = self._pin.buildModelFromXML(urdf_text(z_chain(robot)))
        self._data = self._model.createData()
        self._tip = self._model.getFrameId("tip")
        check_same_robot(self, robot)

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One call a row."""
        T = np.empty((len(q), 4, 4))
        update, place = self._pin.framesForwardKinematics, self._data.oMf
        for k, row in enumerate(q):
            update(self._model, self._data, row)
            T[k] = place[self._tip].homogeneous
        return T

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """One call a row."""
        J = np.empty((len(q), 6, q.shape[1]))
        compute, frame = self._pin.computeFrameJacobian, self._pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for k, row in enumerate(q):
            J[k] = compute(self._model, self._data, row, self._tip, frame)
        return J
