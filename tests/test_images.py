"""Figures look as they did: every case against its reference picture; and the comparison refuses what changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pictures
import pytest
from figure_cases import FIGURES

from ikgrad.plots import style


@pytest.mark.parametrize("name", pictures.CASES)
def test_a_figure_looks_as_it_did(name: str):
    pictures.check(name, pictures.draw(name), pictures.read(pictures.path_of(name)))


def test_the_pictures_are_those_of_the_cases_and_small():
    paths = list(pictures.FOLDER.iterdir())
    assert {path.stem for path in paths} == set(pictures.CASES)
    assert sum(path.stat().st_size for path in paths) < 600_000


def without_a_curve(figure: Any) -> None:
    max(figure.axes[0].lines, key=lambda line: len(line.get_xdata())).remove()


def in_another_colour(figure: Any) -> None:
    for line in figure.axes[0].lines:
        line.set_color("#D55E00" if line.get_color() != "#D55E00" else "#0072B2")


def without_labels(figure: Any) -> None:
    for axes in figure.axes:
        axes.set(xlabel="", ylabel="")


def stretched(figure: Any) -> None:
    axes = figure.axes[0]
    low, high = axes.get_xlim()
    axes.set_xlim(low, low + 1.1 * (high - low) if axes.get_xscale() == "linear" else low * (high / low) ** 1.1)


@pytest.mark.parametrize("change", [without_a_curve, in_another_colour, without_labels, stretched])
@pytest.mark.parametrize("name", ["convergence", "curve_panels", "pose_places"])
def test_a_changed_figure_is_refused(name: str, change: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    drawn = FIGURES[name]

    def changed() -> Any:
        figure = drawn()
        change(figure)
        return figure

    monkeypatch.setitem(FIGURES, name, changed)
    monkeypatch.setattr(pictures, "LEFT", tmp_path)
    with pytest.raises(AssertionError, match=rf"{name}: differs by .* from tests/images/{name}\.png.*{tmp_path}"):
        pictures.check(name, pictures.draw(name), pictures.read(pictures.path_of(name)))
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {f"{name}.png", f"{name}-reference.png", f"{name}-difference.png"}
    assert np.ptp(pictures.read(tmp_path / f"{name}-difference.png")) > 100


@pytest.mark.parametrize("name", ["curve_panels", "method_errors", "pose_places"])
def test_fonts_may_be_drawn_a_little_differently(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(style.STYLE, "font.size", style.STYLE["font.size"] + 0.15)
    monkeypatch.setitem(style.STYLE, "text.antialiased", False)
    found = pictures.difference(pictures.draw(name), pictures.read(pictures.path_of(name)))
    assert 1.5 < found <= pictures.TOLERANCE


def test_another_size_is_another_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pictures, "LEFT", tmp_path)
    reference = pictures.read(pictures.path_of("drift"))
    with pytest.raises(AssertionError, match="drift: differs by inf"):
        pictures.check("drift", reference[:-4], reference)


def test_a_picture_of_nothing_equals_itself():
    blank = np.full((40, 40, 3), 255, dtype=np.uint8)
    assert pictures.difference(blank, blank) == 0.0
    spot = blank.copy()
    spot[16:24, 16:24] = 0
    assert pictures.difference(blank, spot) > pictures.TOLERANCE
