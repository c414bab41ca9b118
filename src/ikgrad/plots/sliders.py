"""A figure with a slider for each value that a reader may want to change."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ikgrad.errors import ConfigError, MissingExtraError
from ikgrad.extras import need
from ikgrad.plots.style import to_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDGET = "application/vnd.jupyter.widget-view+json"


def explore(
    draw: Callable[..., Figure], /, *, start: Mapping[str, Any] | None = None, dpi: int = 80, **choices: Sequence[Any]
) -> Explorer:
    """Show ``draw(**values)`` in a notebook, with one slider a value.

    The last expression of a cell; the picture is drawn anew when a slider is let go. Where a notebook is read and not
    run, or where ipywidgets is missing, the picture of the start values is shown.

    Args:
        draw: takes one keyword for each of ``choices``, returns a figure.
        start: where sliders begin; those that are not named begin at their first value.
        dpi: pixels per inch.
        **choices: keyword of ``draw`` to the values on its slider, in order.

    Raises:
        ConfigError: a slider without values, or ``start`` names a slider or a value that there is not.

    Example:
        >>> import numpy as np
        >>> from ikgrad import plots
        >>> x = np.linspace(0, 1, 50)
        >>> powers = lambda power: plots.traces({"y": x[:, None] ** power}, panels=["y [-]"], xlabel="x [-]", x=x)
        >>> plots.explore(powers, power=[1, 2, 3], start={"power": 2})
        a figure at power = 2
    """
    begin: dict[str, Any] = {}
    for name, values in choices.items():
        if len(values) == 0:
            raise ConfigError(f"explore: the slider {name!r} has no values")
        begin[name] = (start or {}).get(name, values[0])
        if begin[name] not in values:
            raise ConfigError(f"explore: start[{name!r}] must be one of {list(values)}, got {begin[name]!r}")
    if unknown := set(start or {}) - set(choices):
        raise ConfigError(f"explore: start names {sorted(unknown)}, sliders are {sorted(choices)}")
    return Explorer(draw, {name: tuple(values) for name, values in choices.items()}, begin, dpi)


@dataclass(frozen=True)
class Explorer:
    """What `explore` returns; a notebook shows it by itself.

    Attributes:
        draw: values to figure.
        choices: the values on each slider.
        start: where each slider begins.
        dpi: pixels per inch.
    """

    draw: Callable[..., Figure]
    choices: Mapping[str, tuple[Any, ...]]
    start: Mapping[str, Any]
    dpi: int = 80

    def png(self, **values: Any) -> bytes:
        """The picture at these values; what is not given is at its start."""
        return to_png(self.draw(**{**self.start, **values}), dpi=self.dpi)

    def panel(self) -> Any:
        """Sliders and picture as an ipywidgets box.

        Raises:
            MissingExtraError: ipywidgets is not installed.
        """
        ipywidgets = need("ipywidgets", extra="notebook", what="sliders")
        sliders = {name: self._slider(ipywidgets, name) for name in self.choices}
        picture = ipywidgets.Image(value=self.png(), format="png", layout={"align_self": "flex-start"})

        def update(_: Any) -> None:
            picture.value = self.png(**{name: slider.value for name, slider in sliders.items()})

        for slider in sliders.values():
            slider.observe(update, "value")
        return ipywidgets.VBox([*sliders.values(), picture])

    def _slider(self, ipywidgets: Any, name: str) -> Any:
        return ipywidgets.SelectionSlider(
            options=[(_text(value), value) for value in self.choices[name]],
            value=self.start[name],
            description=name.replace("_", " "),
            continuous_update=False,  # a picture may take a second
            style={"description_width": "initial"},
            layout={"width": "28em"},
        )

    def __repr__(self) -> str:
        return "a figure at " + ", ".join(f"{name} = {_text(value)}" for name, value in self.start.items())

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """The still picture for all readers; the sliders beside it, for those who can show them."""
        bundle = {"text/plain": repr(self), "image/png": base64.b64encode(self.png()).decode()}
        try:
            return {**bundle, WIDGET: self.panel()._repr_mimebundle_()[WIDGET]}
        except MissingExtraError:
            return bundle


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
