"""The methods' arms in the scene, one beside the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from ikgrad.plots.style import PALETTE
from ikgrad.robot import Robot
from ikgrad.view.race import Run
from ikgrad.view.scene import ArmNodes, Place, add_axes, rgb

COLOURS = tuple(PALETTE[:4])
GAP = 1.05  # between the arms, in lengths of an arm


class Contest:
    """An arm for every run, each with the target and a name.

    Args:
        server: viser's server.
        robot: the robot.
        runs: of `ikgrad.view.race`.
        T_target: (4, 4) what they ran for [m].
    """

    def __init__(self, server: Any, robot: Robot, runs: Sequence[Run], T_target: Tensor):
        self.runs, self._robot = list(runs), robot
        self.arms = []
        for k, run in enumerate(runs):
            root = f"/race/{k}"
            self.arms.append(ArmNodes(server, robot, root, colour=rgb(COLOURS[k]), place=places(robot, len(runs))[k]))
            add_axes(server, f"{root}/target", T_target, 0.12 * robot.length)
            server.scene.add_label(f"{root}/name", run.name, position=(0.0, 0.0, -0.06 * robot.length))

    def show(self, iteration: int) -> None:
        """Every arm at an iteration, or where its method has ended."""
        from ikgrad.kinematics import link_poses

        for arm, run in zip(self.arms, self.runs, strict=True):
            arm.show(link_poses(self._robot, run.q[run.at(iteration)]))

    def remove(self) -> None:
        """Out of the scene."""
        for arm in self.arms:
            arm.remove()


def places(robot: Robot, count: int) -> list[Place]:
    """Where the arms stand: two in front, the others behind, about the middle of the scene."""
    gap = GAP * robot.length
    return [((k % 2 - 0.5) * gap, (k // 2 - (count - 1) // 2 / 2) * gap, 0.0) for k in range(count)]


__all__ = ["COLOURS", "Contest", "places"]
