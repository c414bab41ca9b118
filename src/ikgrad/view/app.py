"""The page: a scene, controls, and what happens between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.networks.storage import AnyInverter
from ikgrad.plots.style import PALETTE
from ikgrad.rotations import matrix_from_quat_wxyz, quat_wxyz_from_matrix
from ikgrad.view.motion import Motion
from ikgrad.view.obstacles import clearance
from ikgrad.view.panels import JointPanel, Player, RacePanel, when_clicked, when_moved
from ikgrad.view.race import Run, race
from ikgrad.view.scene import (
    ARM,
    BLUE,
    MISSED,
    SKY,
    VERMILLION,
    ArmNodes,
    add_axes,
    add_floor,
    add_path,
    add_spheres,
    camera,
    rgb,
)
from ikgrad.view.server import stop_server
from ikgrad.view.session import GHOSTS, Answer, Session
from ikgrad.view.shapes import arm_parts
from ikgrad.view.worker import Worker

REST = 0.2  # seconds without a change before the other solutions are looked for
METHOD_COLOURS = (PALETTE[0], PALETTE[1], PALETTE[2], PALETTE[3])


class Viewer:
    """One arm on a page, for everybody who opens it.

    Args:
        server: of `start_server`.
        session: the arm.
        motion: joints to play.
        spheres: obstacles.
        inverter: runs beside the methods.
    """

    def __init__(
        self,
        server: Any,
        session: Session,
        *,
        motion: Motion | None = None,
        spheres: Spheres | None = None,
        inverter: AnyInverter | None = None,
    ):
        self.server, self.session, self.worker = server, session, Worker()
        self._motion, self._spheres, self._inverter = motion, spheres, inverter
        self._parts = arm_parts(session.robot)
        self._runs: list[Run] = []
        self._racers: list[ArmNodes] = []
        self._race_player: Player | None = None
        self._build_scene()
        self._build_controls()
        self.joints_changed()

    def close(self) -> None:
        """Stop working and serving."""
        self.worker.stop()
        stop_server(self.server)

    # ------------------------------------------------------------ what the user does

    def drag(self, T_target: Tensor, *, thorough: bool = False) -> None:
        """Move the target there; the newest target wins."""
        self.worker.submit("move", lambda: self.follow(T_target, thorough=thorough))

    def turn(self, joint: int, value: float) -> None:
        """Give one joint a value [rad or m]."""

        def act() -> None:
            q = self.session.q.clone()
            q[joint] = value
            self.session.move_joints(q)
            self.joints_changed()

        self.worker.submit(f"turn {joint}", act)

    def reset(self) -> None:
        """The first pose again."""

        def act() -> None:
            self.session.reset()
            self.joints_changed()

        self.worker.submit("move", act)

    def ask_orientation(self, wanted: bool) -> None:
        """Whether the target's orientation counts."""

        def act() -> None:
            self.session.ask_orientation(wanted)
            self.follow(self.session.T_target)

        self.worker.submit("move", act)

    def start_race(self) -> None:
        """Run the methods from the first pose."""
        self._race.words.content = "running ..."
        self.worker.submit("race", self._run_race)

    def end_race(self) -> None:
        """Back to the one arm."""
        self.worker.submit("race", self._leave_race)

    # ------------------------------------------------------------ what is shown, in the worker's thread

    def follow(self, T_target: Tensor, *, thorough: bool = True) -> Answer:
        """Solve for a target and show the answer."""
        answer = self.session.reach(T_target, thorough=thorough)
        with self.server.atomic():
            self._place_target()
            self._draw(answer.words, answer.success)
        return answer

    def joints_changed(self) -> None:
        """Show the session's joints, the target at the tool."""
        with self.server.atomic():
            self._place_target()
            self._draw("reached", True)

    def show_ghosts(self) -> None:
        """Look for all solutions of the present target, and show those that the arm is not in."""
        found = self.session.solutions(GHOSTS) if self._ghosts_wanted.value else self.session.q[:0].reshape(0, -1)
        others = [q for q in found if bool((q - self.session.q).abs().max() > 1e-3)]
        with self.server.atomic():
            for k, ghost in enumerate(self._ghosts):
                if k < len(others):
                    ghost.show(self.session.poses(others[k]))
                ghost.set_visible(k < len(others) and not self._racers)
        spare = self.session.robot.dof > (3 if self.session.mask else 6)
        self._count.content = _say_count(len(found), spare=spare) if self._ghosts_wanted.value else ""

    def _draw(self, words: str, success: bool) -> None:
        poses = self.session.poses(self.session.q)
        self._arm.show(poses)
        self._arm.paint(ARM if success else MISSED)
        self._joints.show(self.session.q)
        self._words.content = ("**Target:** " if success else "**Target not met:** ") + words
        self._show_clearance(poses)
        for ghost in self._ghosts:
            ghost.set_visible(False)
        self._count.content = ""
        self.worker.submit("ghosts", self.show_ghosts, delay=REST)

    def _show_clearance(self, poses: Tensor) -> None:
        if self._spheres is None:
            return
        found = clearance(self._parts, poses, self._spheres)
        self._clearance.content = f"**Clearance:** {found.words}"
        for k, ball in enumerate(self._balls):
            colour = VERMILLION if k == found.sphere and found.distance <= 0 else BLUE
            if tuple(ball.color) != colour:
                ball.color = colour

    def _place_target(self) -> None:
        T = self.session.T_target
        self._target.position = T[:3, 3].numpy()
        self._target.wxyz = quat_wxyz_from_matrix(T[:3, :3]).numpy()

    def _run_race(self) -> None:
        robot, session = self.session.robot, self.session
        self._leave_race()
        self._race.words.content = "running ..."
        self._runs = race(robot, session.T_target, session.home, mask=session.mask, inverter=self._inverter)
        with self.server.atomic():
            self._set_alone(False)
            for k, run in enumerate(self._runs):
                self._add_racer(k, run)
        self._race_player = self._race.fill(self._runs)
        self._race_player.show(0)
        self._race_player.play()

    def _add_racer(self, k: int, run: Run) -> None:
        gap = 1.1 * self.session.robot.length
        place = ((k - (len(self._runs) - 1) / 2) * gap, 0.0, 0.0)
        colour = rgb(METHOD_COLOURS[k])
        arm = ArmNodes(self.server, self.session.robot, f"/race/{k}", colour=colour, place=place)
        size = 0.12 * self.session.robot.length
        add_axes(self.server, f"/race/{k}/target", self.session.T_target, size)
        height = 1.15 * self.session.robot.length
        self.server.scene.add_label(f"/race/{k}/name", run.name, position=(0.0, 0.0, height))
        self._racers.append(arm)

    def _show_iteration(self, iteration: int) -> None:
        with self.server.atomic():
            for arm, run in zip(self._racers, self._runs, strict=True):
                arm.show(self.session.poses(run.q[run.at(iteration)]))

    def _leave_race(self) -> None:
        if self._race_player is not None:
            self._race_player.stop()
            self._race_player = None
        if not self._racers:
            return
        with self.server.atomic():
            for arm in self._racers:
                arm.remove()
            self._racers, self._runs = [], []
            self._race.clear()
            self._set_alone(True)
        self.joints_changed()

    def _set_alone(self, alone: bool) -> None:
        """Whether the one arm is shown, or the arms of a race."""
        self._arm.set_visible(alone)
        for node in (self._target, *self._around):
            node.visible = alone
        for ghost in self._ghosts:
            ghost.set_visible(False)
        position, look_at = camera(self.session.robot.length, arms=1 if alone else len(self._runs))
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = position, look_at

    def _show_row(self, row: int) -> None:
        assert self._motion is not None
        self.session.move_joints(self._motion.q[row])
        self.joints_changed()

    # ------------------------------------------------------------ at the beginning

    def _build_scene(self) -> None:
        server, robot = self.server, self.session.robot
        add_floor(server, robot)
        self._arm = ArmNodes(server, robot, "/arm")
        self._ghosts = [
            ArmNodes(server, robot, f"/ghosts/{k}", colour=SKY, opacity=0.22, visible=False) for k in range(GHOSTS)
        ]
        self._balls = add_spheres(server, self._spheres) if self._spheres is not None else []
        self._around = [*self._balls]  # what belongs to the one arm's place
        if self._motion is not None:
            self._around.append(add_path(server, self._motion.tool_path(robot)))
        self._target = server.scene.add_transform_controls("/target", scale=0.22 * robot.length, depth_test=False)

        @self._target.on_update
        async def _(event: Any) -> None:
            if event.phase != "start":
                self.drag(_pose(event.target), thorough=event.phase == "end")

    def _build_controls(self) -> None:
        gui, robot = self.server.gui, self.session.robot
        self._words = gui.add_markdown("")
        self._count = gui.add_markdown("")
        if self._spheres is not None:
            self._clearance = gui.add_markdown("")
        self._reset = gui.add_button("Reset")
        when_clicked(self._reset, self.reset)
        orientation = gui.add_checkbox("orientation counts", initial_value=self.session.mask is None)
        when_moved(orientation, self.ask_orientation)
        self._ghosts_wanted = gui.add_checkbox("other solutions", initial_value=True)
        when_moved(self._ghosts_wanted, lambda _: self.worker.submit("ghosts", self.show_ghosts))
        if self._motion is not None:
            self._build_motion(self._motion)
        self._joints = JointPanel(gui, robot, self.turn)
        self._race = RacePanel(
            gui, start=self.start_race, close=self.end_race, show=self._show_iteration, later=self._later("race play"),
            colours=METHOD_COLOURS,
        )  # fmt: skip

    def _build_motion(self, motion: Motion) -> None:
        with self.server.gui.add_folder(f"Motion: {motion.name}"):
            if motion.skipped:
                self.server.gui.add_markdown(f"{motion.skipped:,} rows without finite joints are left out.")
            self._motion_player = Player(
                self.server.gui, "row", len(motion.q), self._show_row, self._later("motion play")
            )

    def _later(self, key: str) -> Callable[[Callable[[], None] | None, float], None]:
        def schedule(task: Callable[[], None] | None, delay: float) -> None:
            self.worker.drop(key) if task is None else self.worker.submit(key, task, delay=delay)

        return schedule


def _pose(handle: Any) -> Tensor:
    """Where a user has dragged something: (4, 4)."""
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = matrix_from_quat_wxyz(torch.tensor(handle.wxyz, dtype=torch.float64))
    T[:3, 3] = torch.tensor(handle.position, dtype=torch.float64)
    return T


def _say_count(count: int, *, spare: bool) -> str:
    """How many solutions were found."""
    if count == 0:
        return ""
    if spare:
        return f"{count} of endlessly many solutions shown"
    at_least = "at least " if count == GHOSTS else ""
    return f"{at_least}{count} solution{'s' * (count != 1)} found"


__all__ = ["Viewer"]
