"""The controls of the page, in their order, and which of the viewer's actions each of them calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ikgrad.view.contest import COLOURS
from ikgrad.view.panels import JointPanel, Player, RacePanel, when_clicked, when_clicked_by, when_moved

if TYPE_CHECKING:
    from ikgrad.view.app import Viewer

SAVE = "Save as HTML"


class Controls:
    """Handles of the controls.

    Args:
        gui: viser's ``server.gui``.
        viewer: what they act on.

    Attributes:
        words: what became of the target.
        count: how many solutions there are.
        clearance: to the obstacles, if there are some.
        method: follows the target.
        ghosts: whether other solutions are wanted.
        joints: the sliders.
        motion: the player, if there is a motion.
        race: methods side by side.
        save: the button.
    """

    clearance: Any
    motion: Player

    def __init__(self, gui: Any, viewer: Viewer):
        self._gui, self._viewer = gui, viewer
        self.words, self.count = gui.add_markdown(""), gui.add_markdown("")
        if viewer.spheres is not None:
            self.clearance = gui.add_markdown("")
        hint = "which method moves the arm when the target is dragged"
        self.method = gui.add_dropdown("follow with", tuple(viewer.methods), hint=hint)
        when_moved(self.method, viewer.use_method)
        self.orientation = gui.add_checkbox("orientation", initial_value=viewer.session.mask is None, hint="counts")
        when_moved(self.orientation, viewer.ask_orientation)
        self.ghosts = gui.add_checkbox("other solutions", initial_value=True)
        when_moved(self.ghosts, viewer.ask_ghosts)
        self.shadows = gui.add_checkbox("shadows", initial_value=True, hint="without them a page without GPU is faster")
        when_moved(self.shadows, viewer.ask_shadows)
        self.reset = gui.add_button("Reset")
        when_clicked(self.reset, viewer.reset)
        self._add_tabs()
        self.save = gui.add_button(SAVE, hint="a page of what is shown, which needs no server")
        when_clicked_by(self.save, viewer.save)

    def _add_tabs(self) -> None:
        gui, viewer, tabs = self._gui, self._viewer, self._gui.add_tab_group()
        if viewer.motion is not None:
            with tabs.add_tab("Motion"):
                gui.add_markdown(viewer.motion.name)
                if viewer.motion.skipped:
                    gui.add_markdown(f"{viewer.motion.skipped:,} rows without finite joints are left out.")
                count = len(viewer.motion.q)
                self.motion = Player(gui, "row", count, viewer.show_row, self._later("motion play"))
        with tabs.add_tab("Joints"):
            self.joints = JointPanel(gui, viewer.session.robot, viewer.turn)
        with tabs.add_tab("Methods side by side"):
            self.race = RacePanel(
                gui, start=viewer.start_race, close=viewer.end_race, show=viewer.show_iteration,
                later=self._later("race play"), colours=COLOURS,
            )  # fmt: skip

    def _later(self, key: str) -> Callable[[Callable[[], None] | None, float], None]:
        worker = self._viewer.worker

        def schedule(task: Callable[[], None] | None, delay: float) -> None:
            worker.drop(key) if task is None else worker.submit(key, task, delay=delay)

        return schedule


__all__ = ["SAVE", "Controls"]
