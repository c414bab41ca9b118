"""Sliders in notebooks: the picture follows them, and is there without them."""

from __future__ import annotations

import base64
import sys
from typing import Any

import numpy as np
import pytest

import ikgrad as ik
from ikgrad import plots
from ikgrad.errors import MissingExtraError
from ikgrad.plots.sliders import WIDGET, Explorer


def line(slope: float = 1.0, points: int = 5) -> Any:
    values = slope * np.arange(points, dtype=float)[:, None]
    return plots.traces({"line": values}, panels=["y [m]"], xlabel="x [-]")


def shown(explorer: Explorer) -> dict[str, Any]:
    return explorer._repr_mimebundle_()


def test_a_slider_begins_at_its_first_value_or_where_it_is_told():
    assert dict(plots.explore(line, slope=[3.0, 1.0]).start) == {"slope": 3.0}
    explorer = plots.explore(line, slope=[3.0, 1.0], points=[5, 9], start={"points": 9})
    assert dict(explorer.start) == {"slope": 3.0, "points": 9}
    assert repr(explorer) == "a figure at slope = 3, points = 9"


def test_the_still_picture_is_that_of_the_start():
    explorer = plots.explore(line, slope=[1.0, -2.0], start={"slope": -2.0})
    still = base64.b64decode(shown(explorer)["image/png"])
    assert still == plots.to_png(line(-2.0), dpi=80)
    assert still != plots.to_png(line(1.0), dpi=80)


def test_without_ipywidgets_the_picture_is_left_and_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    explorer = plots.explore(line, slope=[1.0])
    assert set(shown(explorer)) == {"text/plain", "image/png"}
    with pytest.raises(MissingExtraError, match=r"sliders need ipywidgets; pip install 'ikgrad\[notebook\]'"):
        explorer.panel()


def test_the_picture_follows_the_sliders():
    pytest.importorskip("ipywidgets")
    explorer = plots.explore(line, slope=[1.0, -2.0], points=[5, 9])
    assert WIDGET in shown(explorer)
    slope, points, picture = explorer.panel().children
    assert slope.description == "slope"
    assert [label for label, _ in slope.options] == ["1", "-2"]
    slope.value = -2.0
    assert bytes(picture.value) == explorer.png(slope=-2.0)
    points.value = 9
    assert bytes(picture.value) == explorer.png(slope=-2.0, points=9) != explorer.png()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"slope": []}, "the slider 'slope' has no values"),
        ({"slope": [1.0], "start": {"slope": 2.0}}, r"start\['slope'\] must be one of \[1.0\], got 2.0"),
        ({"slope": [1.0], "start": {"point": 2}}, r"start names \['point'\], sliders are \['slope'\]"),
    ],
)
def test_mistakes_are_named(arguments: dict[str, Any], words: str):
    with pytest.raises(ik.ConfigError, match=words):
        plots.explore(line, **arguments)
