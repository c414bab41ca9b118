"""What stands in the scene: the arm, its other solutions, obstacles, the way of the tool, and the target."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.kinematics import link_poses
from ikgrad.robot import Robot
from ikgrad.rotations import matrix_from_quat_wxyz, quat_wxyz_from_matrix
from ikgrad.view.meshes import Look
from ikgrad.view.motion import Motion
from ikgrad.view.obstacles import clearance
from ikgrad.view.scene import BLUE, SKY, VERMILLION, ArmNodes, add_floor, add_path, add_spheres, camera
from ikgrad.view.session import GHOSTS
from ikgrad.view.shapes import arm_parts


class Stage:
    """The scene of a page with one arm.

    Args:
        server: viser's server.
        robot: the robot, n joint variables.
        motion: whose way is drawn.
        spheres: obstacles.
        look: the arm's own meshes.
    """

    def __init__(
        self,
        server: Any,
        robot: Robot,
        *,
        motion: Motion | None = None,
        spheres: Spheres | None = None,
        look: Look | None = None,
    ):
        self.server, self.robot, self.spheres = server, robot, spheres
        self._parts = arm_parts(robot)
        add_floor(server, robot)
        self.arm = ArmNodes(server, robot, "/arm", look=look)
        self.ghosts = [
            ArmNodes(server, robot, f"/ghosts/{k}", colour=SKY, opacity=0.22, visible=False) for k in range(GHOSTS)
        ]
        self.balls = add_spheres(server, spheres) if spheres is not None else []
        self.target = server.scene.add_transform_controls("/target", scale=0.22 * robot.length, depth_test=False)
        self._around = [self.target, *self.balls]  # what belongs to the one arm's place
        if motion is not None:
            self._around.append(add_path(server, motion.tool_path(robot)))

    def when_dragged(self, act: Callable[[Tensor, bool], None]) -> None:
        """Call a function with the pose that a user gives the target, and whether it has been let go."""

        @self.target.on_update
        async def _(event: Any) -> None:
            if event.phase != "start":
                act(_pose(event.target), event.phase == "end")

    def show(self, q: Tensor, T_target: Tensor, *, missed: bool) -> str:
        """The arm and the target; the other solutions of before are gone.

        Args:
            q: (n,) joints.
            T_target: (4, 4) the target [m].
            missed: the arm turns grey.

        Returns:
            The clearance in words, empty without obstacles.
        """
        poses = link_poses(self.robot, q)
        self.arm.show(poses)
        self.arm.show_missed(missed)
        self.show_others(())
        self.target.position = T_target[:3, 3].numpy()
        self.target.wxyz = quat_wxyz_from_matrix(T_target[:3, :3]).numpy()
        return self._clearance(poses)

    def show_others(self, solutions: tuple[Tensor, ...]) -> None:
        """Translucent arms, one for each (n,) joints, at most `GHOSTS`."""
        for k, ghost in enumerate(self.ghosts):
            if k < len(solutions):
                ghost.show(link_poses(self.robot, solutions[k]))
            ghost.set_visible(k < len(solutions))

    def set_alone(self, alone: bool, *, arms: int = 1) -> None:
        """Whether the one arm is shown with what is around it, or so many arms of a race, and what cameras see."""
        self.arm.set_visible(alone)
        for node in self._around:
            node.visible = alone
        self.show_others(())
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = camera(self.robot.length, arms=arms)

    def _clearance(self, poses: Tensor) -> str:
        if self.spheres is None:
            return ""
        found = clearance(self._parts, poses, self.spheres)
        for k, ball in enumerate(self.balls):
            colour = VERMILLION if k == found.sphere and found.distance <= 0 else BLUE
            if tuple(ball.color) != colour:
                ball.color = colour
        return found.words


def _pose(handle: Any) -> Tensor:
    """Where a user has dragged something: (4, 4)."""
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = matrix_from_quat_wxyz(torch.tensor(handle.wxyz, dtype=torch.float64))
    T[:3, 3] = torch.tensor(handle.position, dtype=torch.float64)
    return T


__all__ = ["Stage"]
