"""TRAC-IK (C++, through pytracik): Newton with restarts and SQP, in two threads of its own, a pose a call."""

from __future__ import annotations

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, check_same_robot, foreign
from ikgrad.bench.peers.chain import urdf_text, z_chain
from ikgrad.robot import Robot

TIMEOUT = 0.1  # seconds a pose where the protocol names no cap


class TracIK(Peer):
    """``TRAC_IK`` in its mode Speed: the first solution counts."""

    name = "pytracik"
    package = "pytracik"
    module = "pytracik"
    settings = f"TRAC_IK, Speed, starts in the middle unless given, cap of the protocol or {TIMEOUT} s, two threads"

    def check(self, robot: Robot) -> None:
        """No coupled joints."""
        z_chain(robot)

    def prepare(self, robot: Robot, question: Question) -> None:
        """From a URDF document written out of our tables."""
        tracik = foreign("pytracik")
        chain = z_chain(robot)
        eps = min(question.tol_pos, question.tol_rot)
        # Its eps bounds each of the six components, the protocols bound the two norms.
        eps /= 3**0.5
        low, high = (
            chain.q_min.astype(np.float32),
            chain.q_max.astype(np.float32),
        )  # it keeps limits in single precision
        low = np.where(low < chain.q_min, np.nextafter(low, np.float32(np.inf)), low)
        high = np.where(high > chain.q_max, np.nextafter(high, np.float32(-np.inf)), high)
        text = urdf_text(chain._replace(q_min=low.astype(float), q_max=high.astype(float)))
        self._solver = tracik.TRAC_IK("l0", "tip", text, question.timeout or TIMEOUT, eps, tracik.SolveType.Speed)
        self._module = tracik
        self._middle = (chain.q_min + chain.q_max) / 2
        check_same_robot(self, robot)

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """It wants a quaternion."""
        start = self._middle if q0 is None else q0
        x, y, z, w = _quat_xyzw(T[:3, :3])
        answer = self._module.ik(self._solver, start, T[0, 3], T[1, 3], T[2, 3], x, y, z, w)
        return np.array(answer[1:]) if answer[0] >= 0 else np.full(len(start), np.nan)

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One call a row; only to see that it is the same robot."""
        return np.stack([np.array(self._module.fk(self._solver, row)) for row in q])


def _quat_xyzw(R: np.ndarray) -> np.ndarray:
    """Quaternion of a rotation matrix; the largest component is computed first, so nothing cancels."""
    K = np.array(
        [
            [1 + R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
            [R[1, 0] + R[0, 1], 1 - R[0, 0] + R[1, 1] - R[2, 2], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
            [R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], 1 - R[0, 0] - R[1, 1] + R[2, 2], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    row = K[int(np.argmax(np.diag(K)))]
    return row / np.linalg.norm(row)
