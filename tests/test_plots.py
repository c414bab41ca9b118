"""Figures: written, not blank, the same each time, and without global state."""

from __future__ import annotations

import io
import itertools
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import torch
from figure_cases import BALL, FIGURES, HITS, LINKS, WAY, T, motions, with_clearance
from PIL import Image

import ikgrad as ik
from ikgrad import plots
from ikgrad.collision import Spheres, link_segments
from ikgrad.errors import ConfigError, DataError
from ikgrad.plots import tubes


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), dtype=float)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_written_and_not_blank(name: str, tmp_path: Path):
    path = plots.save_figure(FIGURES[name](), tmp_path / "figure.png", dpi=60)
    image = pixels(path)
    assert image.shape[0] > 120
    assert image.shape[1] > 240
    drawn = (image.min(axis=-1) < 200).mean()  # share of pixels that are not nearly white
    assert 0.005 < drawn < 0.6
    colourful = (np.ptp(image, axis=-1) > 60).mean()
    assert colourful > 0.001


@pytest.mark.parametrize("name", FIGURES)
def test_the_same_figure_is_drawn_twice(name: str, tmp_path: Path):
    """A grey level per pixel on average: fonts may be hinted differently from machine to machine, not within one."""
    first, second = (pixels(plots.save_figure(FIGURES[name](), tmp_path / f"{k}.png", dpi=60)) for k in "ab")
    assert np.abs(first - second).mean() < 1


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_has_a_label_with_a_unit(name: str):
    counts = ("iteration", "motion", "epoch", "step", "row")  # what is counted has no unit
    labels = []
    for axes in FIGURES[name]().axes:
        solid = axes.name == "3d"  # there, axison is always off
        if solid or axes.axison:
            labels += [axes.get_xlabel(), axes.get_ylabel(), *([axes.get_zlabel()] if solid else [])]
    written = [label for label in labels if label]
    assert written
    assert all("[" in label or label in counts for label in written), written


def test_a_crowd_of_traces_has_no_legend():
    few, crowd = (
        plots.traces({str(k): WAY for k in range(count)}, panels=["x [m]"] * 3, xlabel="step") for count in (7, 8)
    )
    assert len(few.legends) == 1
    assert not crowd.legends


def test_closeups_show_their_window_alone():
    axes = FIGURES["closeups"]().axes
    for panel in axes:
        x = panel.lines[-1].get_xdata()
        assert 0.2 <= x.min() < x.max() <= 0.5
    np.testing.assert_allclose(axes[1].lines[-1].get_ydata(), 0.01 * WAY[(T >= 0.2) & (T <= 0.5), 0], atol=1e-12)


def test_svg_is_written_by_suffix_and_is_reproducible(tmp_path: Path):
    first, second = (plots.save_figure(FIGURES["comparison_bars"](), tmp_path / f"{k}.svg") for k in "ab")
    assert first.read_text().lstrip().startswith("<?xml")
    assert first.read_bytes() == second.read_bytes()


def test_an_existing_figure_is_kept_without_force(tmp_path: Path):
    path = tmp_path / "figure.png"
    path.write_text("mine")
    with pytest.raises(DataError, match="exists already"):
        plots.save_figure(FIGURES["comparison_bars"](), path, force=False)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


def test_other_kinds_of_files_are_refused(tmp_path: Path):
    with pytest.raises(DataError, match=r"figure\.bmp: unknown kind of file '\.bmp' \(known: \.png, \.svg\)"):
        plots.save_figure(FIGURES["comparison_bars"](), tmp_path / "figure.bmp")


def test_a_missing_folder_is_refused(tmp_path: Path):
    with pytest.raises(DataError, match="cannot write the figure: No such file"):
        plots.save_figure(FIGURES["comparison_bars"](), tmp_path / "no" / "figure.png")


def test_drawing_leaves_matplotlib_as_it_was(tmp_path: Path):
    before = dict(matplotlib.rcParams)
    plots.save_figure(FIGURES["arm_path"](), tmp_path / "figure.png")
    assert dict(matplotlib.rcParams) == before


def test_no_pyplot_and_no_matplotlib_before_the_first_figure():
    code = "import sys, ikgrad.plots as p; a = 'matplotlib' in sys.modules; p.new_figure((2, 2)); "
    code += "sys.exit(a or 'matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_tubes_that_two_poses_share_are_drawn_once():
    points = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 1], [1, 0, 1]])
    other = points.copy()
    other[3] = [0, 1, 1]
    whole, rest = tubes.arm_mesh(points, 0.1), tubes.arm_mesh(points, 0.1, skip=other)
    assert 0 < len(rest.faces) < len(whole.faces)
    assert rest.faces[..., 2].min() > 0.8  # nothing of the column below the first bend
    assert len(whole.faces) == len(whole.shade) == len(whole.joint)


def test_an_animation_has_a_frame_an_instant_and_moves(tmp_path: Path):
    path = plots.save_sweep(tmp_path / "arm.gif", LINKS, predicted=LINKS, touching=HITS, **BALL, dpi=40)
    with Image.open(path) as film:
        assert film.n_frames == len(LINKS)
        frames = []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB")))
    assert all((a != b).any() for a, b in itertools.pairwise(frames))
    assert [path.name for path in tmp_path.iterdir()] == ["arm.gif"]
    with pytest.raises(DataError, match="gif"):
        plots.save_sweep(tmp_path / "arm.mp4", LINKS, predicted=LINKS, touching=HITS, **BALL)


def test_traces_stand_where_they_are_told():
    figure = plots.traces({"a": LINKS[:, 0, 0]}, panels=["x", "y", "z"], xlabel="time [s]", x=np.arange(6) / 2)
    assert figure.axes[0].lines[0].get_xdata().tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]


def test_links_that_touch_are_red_and_others_are_not():
    def red(centre: float) -> float:
        ball = Spheres(torch.tensor([[centre, 0.0, 0.6]]), torch.tensor([0.1]))
        figure = plots.arm_motion(ik.load_robot("panda"), motions(), ball, link_radius=0.05)
        image = np.asarray(Image.open(io.BytesIO(plots.to_png(figure))).convert("RGB"), dtype=float)
        return ((image[..., 0] > 130) & (image[..., 1] < 45) & (image[..., 2] < 60)).mean()

    assert red(0.5) > 0.002
    assert red(1.2) < 1e-4


def test_the_chart_tells_the_distance_to_the_nearest_obstacle():
    *_, chart = with_clearance().axes
    first, again, margin = chart.lines
    robot, line = ik.load_robot("panda"), motions()["line"]
    q = line.position(torch.linspace(0, 1, 400).to(line.times))
    links = link_segments(robot, q.double())
    ball = Spheres(torch.tensor([[0.5, 0.0, 0.5]]), torch.tensor([0.12]))
    gap = ball.distance(links, 0.03).amin(dim=(-2, -1))
    np.testing.assert_allclose(first.get_ydata(), 1e3 * gap.numpy(), atol=1e-2)  # [mm]; times are float32
    np.testing.assert_allclose(first.get_xdata()[[0, -1]], [0.0, 1.0])
    assert list(margin.get_ydata()) == [20.0, 20.0]
    assert first.get_color() != again.get_color()


def test_a_film_moves(tmp_path: Path):
    ball = Spheres(torch.tensor([[0.5, 0.0, 0.5]]), torch.tensor([0.12]))
    robot = ik.load_robot("panda")
    path = plots.save_motion(robot, motions(), ball, tmp_path / "film.gif", frames=3, seconds=1.5, dpi=40)
    with Image.open(path) as film:
        assert film.n_frames == 3
        assert film.info["duration"] == 500
        first = np.asarray(film.convert("RGB"), dtype=float)
        film.seek(2)
        assert np.abs(np.asarray(film.convert("RGB"), dtype=float) - first).mean() > 1
    with pytest.raises(DataError, match=r"unknown kind of file '\.mov' \(known: \.gif\)"):
        plots.save_motion(robot, motions(), ball, tmp_path / "film.mov")
    with pytest.raises(DataError, match="exists already"):
        plots.save_motion(robot, motions(), ball, path, frames=1, dpi=30, force=False)
    batch = {"two": ik.via_point_trajectory(torch.rand(2, 2, 7), [0.0, 1.0])}
    with pytest.raises(ConfigError, match=r"must be a single trajectory, got a batch of shape \(2,\): take one row"):
        plots.arm_motion(robot, batch, ball)
