"""The controls beside the scene. Handles are viser's; what they do is handed in as functions.

Callbacks are coroutines without an ``await``: so they run in the order in which the page sent them. What a program
writes into a control comes back without a client, and is none of the user's doing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from torch import Tensor

from ikgrad.robot import Robot
from ikgrad.view.race import Run, curves, iterations_to_show

SECONDS_A_PICTURE = 1 / 30
NANOMETRE = 1e-9  # no curve falls below: ticks have three decimals of a micrometre


def when_moved(control: Any, act: Callable[[Any], None]) -> None:
    """Call a function with the value that a user gives a control."""

    @control.on_update
    async def _(event: Any) -> None:
        if event.client_id is not None:
            act(event.target.value)


def when_clicked(button: Any, act: Callable[[], None]) -> None:
    """Call a function when a user presses a button."""
    when_clicked_by(button, lambda _: act())


def when_clicked_by(button: Any, act: Callable[[Any], None]) -> None:
    """The same with viser's handle of the client that pressed it."""

    @button.on_click
    async def _(event: Any) -> None:
        act(event.client)


class JointPanel:
    """A slider for every joint, in degrees or metres.

    Args:
        gui: viser's ``server.gui``.
        robot: the robot, n joint variables.
        moved: called with the joint's index and its new value [rad or m].
    """

    def __init__(self, gui: Any, robot: Robot, moved: Callable[[int, float], None]):
        low, high = (limit.tolist() for limit in robot.sampling_range)
        self._units = [math.pi / 180 if variable.kind == "revolute" else 1.0 for variable in robot.variables]
        self._sliders = []
        names = short_names(robot.joint_names)
        for k, (variable, unit) in enumerate(zip(robot.variables, self._units, strict=True)):
            label = f"{names[k]} [{'deg' if variable.kind == 'revolute' else 'm'}]"
            digits = 1 if variable.kind == "revolute" else 3
            least, most = _inside(low[k] / unit, high[k] / unit, digits)
            slider = gui.add_slider(
                label, min=least, max=most, step=10.0**-digits, initial_value=least, hint=variable.name
            )
            when_moved(slider, partial(_in_si, moved, k, unit))
            self._sliders.append(slider)

    def show(self, q: Tensor) -> None:
        """Set the sliders; an endless joint shows its angle within one turn."""
        for slider, unit, value in zip(self._sliders, self._units, q.tolist(), strict=True):
            shown = value / unit
            if unit != 1.0 and not slider.min <= shown <= slider.max:
                shown = (shown + 180) % 360 - 180
            slider.value = min(max(round(shown, 3), slider.min), slider.max)


def short_names(names: Sequence[str]) -> list[str]:
    """Names without the words at their beginning and end that all of them share: the panel is narrow.

    Example:
        >>> short_names(["shoulder_pan_joint", "elbow_joint"]), short_names(["panda_joint1", "panda_joint2"])
        (['shoulder_pan', 'elbow'], ['joint1', 'joint2'])
    """
    words = [name.split("_") for name in names]
    while len(words) > 1 and min(map(len, words)) > 1 and len({each[0] for each in words}) == 1:
        words = [each[1:] for each in words]
    while len(words) > 1 and min(map(len, words)) > 1 and len({each[-1] for each in words}) == 1:
        words = [each[:-1] for each in words]
    return ["_".join(each) for each in words]


def _inside(low: float, high: float, digits: int) -> tuple[float, float]:
    """The range with so many decimals, rounded inwards; a locked joint keeps a range of one step."""
    scale = 10**digits
    least, most = math.ceil(low * scale - 1e-6) / scale, math.floor(high * scale + 1e-6) / scale
    return (least, most) if most > least else (least, least + 1 / scale)


def _in_si(moved: Callable[[int, float], None], k: int, unit: float, value: float) -> None:
    moved(k, value * unit)


class Player:
    """A slider with a play button.

    Args:
        gui: viser's ``server.gui``.
        label: of the slider.
        count: of pictures.
        show: called with the picture's index.
        later: runs a function once after so many seconds, in place of what it was to run; None: nothing any more.
        a_second: pictures a second; None: a slider says it.
    """

    def __init__(
        self,
        gui: Any,
        label: str,
        count: int,
        show: Callable[[int], None],
        later: Callable[[Callable[[], None] | None, float], None],
        *,
        a_second: float | None = None,
    ):
        self._count, self._show, self._later = count, show, later
        self._slider = gui.add_slider(label, min=0, max=max(count - 1, 1), step=1, initial_value=0, disabled=count < 2)
        self._speed = None if a_second else gui.add_slider("rows per second", min=1, max=240, step=1, initial_value=30)
        self._fixed, self._position = a_second, 0.0
        self._button = gui.add_button("Play", disabled=count < 2)
        self._playing = False
        self.controls = [self._slider, self._button] + ([self._speed] if self._speed else [])
        when_moved(self._slider, self._jump)
        when_clicked(self._button, self._toggle)

    def show(self, index: int) -> None:
        """Go to a picture."""
        self._slider.value = index
        self._show(index)

    def stop(self) -> None:
        """Stand still."""
        self._playing, self._button.label = False, "Play"
        self._later(None, 0.0)

    def play(self) -> None:
        """From here to the end, or from the beginning if this is the end."""
        self._position = 0.0 if self._slider.value >= self._count - 1 else float(self._slider.value)
        self._playing, self._button.label = True, "Pause"
        self._later(self._tick, 0.0)

    def _toggle(self) -> None:
        self.stop() if self._playing else self.play()

    def _jump(self, index: int) -> None:
        if self._playing:
            self.stop()
        self._later(lambda: self._show(index), 0.0)

    def _tick(self) -> None:
        self.show(int(self._position))
        if int(self._position) >= self._count - 1:
            return self.stop()
        rate = self._fixed or self._speed.value  # type: ignore[union-attr]
        self._position = min(self._position + rate * SECONDS_A_PICTURE, self._count - 1)
        if self._playing:
            self._later(self._tick, SECONDS_A_PICTURE)
        return None


class RacePanel:
    """The methods, their iterations and their error curves.

    Args:
        gui: viser's ``server.gui``.
        start: called when the user wants a race.
        close: called when the user has seen enough.
        show: called with the iteration to show.
        later: see `Player`.
        colours: of the methods, as web pages write them.
    """

    def __init__(
        self,
        gui: Any,
        *,
        start: Callable[[], None],
        close: Callable[[], None],
        show: Callable[[int], None],
        later: Callable[[Callable[[], None] | None, float], None],
        colours: Sequence[str],
    ):
        self._gui, self._show, self._later, self._colours = gui, show, later, colours
        self._start = gui.add_button("Run on this target")
        self._close = gui.add_button("Back to the arm", visible=False)
        self.words = gui.add_markdown("From the first pose to the target, every iteration kept.")
        self._place = gui.add_folder("Iterations", visible=False)
        when_clicked(self._start, start)
        when_clicked(self._close, close)
        self._shown: list[Any] = []

    def fill(self, runs: Sequence[Run]) -> Player:
        """Show the results of a race, and how to play it."""
        for part in self._shown:
            part.remove()
        shown = iterations_to_show(runs)
        lines = [
            f'<span style="color:{colour}">■</span> **{run.name}**: {run.words}'
            for run, colour in zip(runs, self._colours, strict=False)
        ]
        self.words.content = "<br>".join(lines)
        self._close.visible = self._place.visible = True
        with self._place:
            chart = self._chart(runs)
            player = Player(
                self._gui, "iteration", len(shown), lambda k: self._show(shown[k]), self._later, a_second=15
            )
        self._shown = [chart, *player.controls]
        return player

    def leave(self) -> None:
        """The arms are gone; words and curves stay until the next race."""
        self._close.visible = False
        for control in self._shown[1:]:
            control.visible = False

    def _chart(self, runs: Sequence[Run]) -> Any:
        steps, errors = curves(runs, floor=NANOMETRE)
        series = [{"label": "evaluation"}] + [
            {"label": run.name, "stroke": colour, "width": 2} for run, colour in zip(runs, self._colours, strict=False)
        ]
        logarithmic = {"distr": 3, "log": 10}
        quiet = {"grid": {"stroke": "rgba(0,0,0,0.05)"}, "ticks": {"show": False}}
        return self._gui.add_uplot(
            data=(steps.numpy(), *(row.numpy() for row in 1e6 * errors)),
            series=tuple(series),
            scales={"x": {"time": False, **logarithmic}, "y": dict(logarithmic)},
            axes=({"label": "evaluation", **quiet}, {"label": "position error [µm]", "size": 72, **quiet}),
            aspect=1.25,
            padding=(16, 24, 0, 0),
        )


__all__ = ["JointPanel", "Player", "RacePanel", "when_clicked", "when_clicked_by", "when_moved"]
