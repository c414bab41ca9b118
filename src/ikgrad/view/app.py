"""The page: what people do on it, and what is then shown. `stage` holds the scene, `controls` the controls."""

from __future__ import annotations

from functools import partial
from typing import Any

from torch import Tensor

from ikgrad.collision import Spheres
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.networks.storage import AnyInverter
from ikgrad.view.contest import Contest
from ikgrad.view.controls import SAVE, Controls
from ikgrad.view.export import page_html
from ikgrad.view.follow import methods
from ikgrad.view.meshes import Look
from ikgrad.view.motion import Motion
from ikgrad.view.panels import Player
from ikgrad.view.race import race
from ikgrad.view.server import stop_server
from ikgrad.view.session import GHOSTS, Answer, Session
from ikgrad.view.stage import Stage
from ikgrad.view.worker import Worker

REST = 0.2  # seconds without a change before the other solutions are looked for


class Viewer:
    """One arm on a page, for everybody who opens it.

    Args:
        server: of `start_server`.
        session: the arm.
        motion: joints to play.
        spheres: obstacles.
        inverter: runs beside the methods, and may follow the target.
        look: the arm's own meshes.
    """

    def __init__(
        self,
        server: Any,
        session: Session,
        *,
        motion: Motion | None = None,
        spheres: Spheres | None = None,
        inverter: AnyInverter | None = None,
        look: Look | None = None,
    ):
        self.server, self.session, self.worker = server, session, Worker()
        self.motion, self.spheres, self._inverter, self._look = motion, spheres, inverter, look
        self.methods = methods(inverter)
        self.stage = Stage(server, session.robot, motion=motion, spheres=spheres, look=look)
        self.stage.when_dragged(lambda T, let_go: self.drag(T, thorough=let_go))
        self._contest: Contest | None = None
        self._race_player: Player | None = None
        self._playing = False  # the arm stands in a row of the motion
        self._controls = Controls(server.gui, self)
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

    def use_method(self, name: str) -> None:
        """Follow the target with another method of ``methods``, from here."""

        def act() -> None:
            self.session.method = self.methods[name]
            self.follow(self.session.T_target)

        self.worker.submit("move", act)

    def ask_ghosts(self, wanted: bool) -> None:
        """Whether the other solutions are shown."""
        self.worker.submit("ghosts", self.show_ghosts)

    def ask_shadows(self, wanted: bool) -> None:
        """Whether things throw shadows, which costs half of the drawing where there is no GPU."""
        self.server.scene.configure_default_lights(cast_shadow=wanted)

    def start_race(self) -> None:
        """Run the methods from the first pose."""
        self._controls.race.words.content = "running ..."
        self.worker.submit("race", self._run_race)

    def end_race(self) -> None:
        """Back to the one arm."""
        self.worker.submit("race", self._leave_race)

    def save(self, client: Any) -> None:
        """Let a browser download what is shown as a page."""
        self._controls.save.label = "Saving ..."
        self.worker.submit("save", lambda: self._save(client))

    # ------------------------------------------------------------ what is shown, in the worker's thread

    def follow(self, T_target: Tensor, *, thorough: bool = True) -> Answer:
        """Go to a target and show the answer; a method that is on its way goes on until the target changes."""
        self._playing = False
        answer = self.session.reach(T_target, thorough=thorough)
        self._show(answer.words, answer.success, near=answer.near)
        if answer.more:
            self.worker.submit("go on", partial(self._go_on, T_target))
        return answer

    def _go_on(self, T_target: Tensor) -> None:
        if self.session.T_target is T_target and self._contest is None:
            self.follow(T_target)

    def joints_changed(self) -> None:
        """Show the session's joints, the target at the tool."""
        self._playing = False
        self._show("reached", True)

    def show_row(self, row: int) -> None:
        """A row of the motion."""
        assert self.motion is not None
        self.session.move_joints(self.motion.q[row])
        self.joints_changed()
        self._playing = True

    def show_ghosts(self) -> None:
        """Look for all solutions of the present target, and show those that the arm is not in."""
        wanted = self._controls.ghosts.value and self._contest is None
        found = self.session.solutions(GHOSTS) if wanted else self.session.q[None, :][:0]
        with self.server.atomic():
            self.stage.show_others(tuple(q for q in found if bool((q - self.session.q).abs().max() > 1e-3)))
        self._controls.count.content = _say_count(len(found), spare=self.session.spare) if wanted else ""

    def _show(self, words: str, success: bool, *, near: bool = False) -> None:
        """The session's joints and target, and what there is to say."""
        with self.server.atomic():
            clear = self.stage.show(self.session.q, self.session.T_target, missed=not (success or near))
            self._controls.joints.show(self.session.q)
            state = "Target" if success else "Target nearly met" if near else "Target not met"
            self._controls.words.content = f"**{state}:** {words}"
            if clear:
                self._controls.clearance.content = f"**Clearance:** {clear}"
            self._controls.count.content = ""
        self.worker.submit("ghosts", self.show_ghosts, delay=REST)

    def _run_race(self) -> None:
        session, panel = self.session, self._controls.race
        self._leave_race()
        if pose_error(session.T_target, forward_kinematics(session.robot, session.home)).norm() < 1e-3:
            panel.words.content = "The target is where all of them would start: drag it away first."
            return
        panel.words.content = "running ..."
        runs = race(session.robot, session.T_target, session.home, mask=session.mask, inverter=self._inverter)
        with self.server.atomic():
            self._contest = Contest(self.server, session.robot, runs, session.T_target)
            self.stage.set_alone(False, arms=len(runs))
        self._race_player = panel.fill(runs)
        self._race_player.show(0)
        self._race_player.play()

    def show_iteration(self, iteration: int) -> None:
        """The race's arms at an iteration."""
        if self._contest is not None:
            with self.server.atomic():
                self._contest.show(iteration)

    def _leave_race(self) -> None:
        if self._race_player is not None:
            self._race_player.stop()
            self._race_player = None
        if self._contest is None:
            return
        with self.server.atomic():
            self._contest.remove()
            self._contest = None
            self._controls.race.leave()
            self.stage.set_alone(True)
        self.joints_changed()

    def _save(self, client: Any) -> None:
        runs = self._contest.runs if self._contest else ()
        text = page_html(
            self.session,
            motion=self.motion if self._playing else None,
            spheres=self.spheres,
            look=self._look,
            runs=runs,
            ghosts=self._controls.ghosts.value,
            view=(client.camera.position, client.camera.look_at),
        )
        what = "race" if runs else "motion" if self._playing else "pose"
        name = f"{self.session.robot.name}-{what}.html"
        client.send_file_download(name, text.encode(), save_immediately=True)
        self._controls.save.label = SAVE


def _say_count(count: int, *, spare: bool) -> str:
    """How many solutions were found."""
    if count == 0:
        return ""
    if spare:
        return f"{count} of endlessly many solutions shown"
    at_least = "at least " if count == GHOSTS else ""
    return f"{at_least}{count} solution{'s' * (count != 1)} found"


__all__ = ["Viewer"]
