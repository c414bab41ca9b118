"""Robotics Toolbox for Python: the Levenberg-Marquardt solver in C++, a pose a call."""

from __future__ import annotations

from typing import Any

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, check_same_robot, foreign
from ikgrad.bench.peers.chain import z_chain
from ikgrad.robot import Robot


class RoboticsToolbox(Peer):
    """``ETS.ik_LM`` with the damping that was the fastest of ten settings tried on panda, ur5e and kr210."""

    name = "roboticstoolbox"
    package = "roboticstoolbox-python"
    module = "roboticstoolbox"
    jobs = frozenset({"ik", "fk", "jacobian"})
    settings = "ETS.ik_LM, joint_limits=True, method='chan', k=0.1, residual tolerance tol^2/2, else defaults"
    damping = 0.1

    def check(self, robot: Robot) -> None:
        """No coupled joints."""
        z_chain(robot)

    def prepare(self, robot: Robot, question: Question) -> None:
        """An elementary transform sequence out of our tables."""
        rtb = foreign("roboticstoolbox")
        chain = z_chain(robot)
        parts: list[Any] = []
        for origin, slide, low, high in zip(chain.origins, chain.slides, chain.q_min, chain.q_max, strict=True):
            parts += [rtb.ET.SE3(origin), (rtb.ET.tz if slide else rtb.ET.Rz)(qlim=[low, high])]
        self._ets = rtb.ETS([*parts, rtb.ET.SE3(chain.tool)])
        self._tol = 0.5 * min(question.tol_pos, question.tol_rot) ** 2  # its residual is e^T e / 2
        check_same_robot(self, robot)

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """Without a start it draws random ones."""
        return self._ets.ik_LM(T, q0=q0, tol=self._tol, k=self.damping).q

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One C++ call a row."""
        return np.stack([self._ets.eval(row) for row in q])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """One C++ call a row."""
        return np.stack([self._ets.jacob0(row) for row in q])


class RoboticsToolboxDefaults(RoboticsToolbox):
    """The same with its own damping, as one who reads no further would call it."""

    name = "roboticstoolbox-defaults"
    jobs = frozenset({"ik"})
    settings = "ETS.ik_LM, joint_limits=True, residual tolerance tol^2/2, else defaults (method='chan', k=1)"
    damping = 1.0
