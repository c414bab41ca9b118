"""ikpy: least squares of scipy over numpy matrices, a pose a call."""

from __future__ import annotations

import numpy as np

from ikgrad.bench.peers.base import Peer, Question, check_same_robot, foreign
from ikgrad.bench.peers.chain import rpy, z_chain
from ikgrad.robot import Robot


class IkPy(Peer):
    """``Chain.inverse_kinematics_frame`` on the whole pose."""

    name = "ikpy"
    package = "ikpy"
    module = "ikpy"
    settings = "Chain.inverse_kinematics_frame, orientation_mode='all', starts in the middle unless given, tol=1e-15"

    def check(self, robot: Robot) -> None:
        """No coupled joints."""
        z_chain(robot)

    def prepare(self, robot: Robot, question: Question) -> None:
        """Links out of our tables; the flange is a fixed link at the end."""
        link, chain = foreign("ikpy.link"), z_chain(robot)
        links = [link.OriginLink()]
        for k, origin in enumerate(chain.origins):
            kind = {"translation": (0, 0, 1), "joint_type": "prismatic"} if chain.slides[k] else {"rotation": (0, 0, 1)}
            bounds = (float(chain.q_min[k]), float(chain.q_max[k]))
            links.append(link.URDFLink(f"j{k}", origin[:3, 3], rpy(origin[:3, :3]), bounds=bounds, **kind))
        links.append(link.URDFLink("tip", chain.tool[:3, 3], rpy(chain.tool[:3, :3]), joint_type="fixed"))
        active = [False] + [True] * len(chain.origins) + [False]
        self._chain = foreign("ikpy.chain").Chain(links, active_links_mask=active)
        self._middle = (chain.q_min + chain.q_max) / 2
        check_same_robot(self, robot)

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """Its joint vector has an entry for the base and one for the flange."""
        start = np.concatenate([[0], self._middle if q0 is None else q0, [0]])
        answer = self._chain.inverse_kinematics_frame(T, initial_position=start, orientation_mode="all", tol=1e-15)
        return np.asarray(answer[1:-1])

    def fk(self, q: np.ndarray) -> np.ndarray:
        """One call a row; only to see that it is the same robot."""
        return np.stack([self._chain.forward_kinematics([0, *row, 0]) for row in q])
