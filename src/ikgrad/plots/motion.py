"""An arm swept along trajectories among obstacles: pictures side by side, or a film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ikgrad.collision import Capsules, Spheres, link_segments
from ikgrad.errors import ConfigError
from ikgrad.files.places import check_suffix
from ikgrad.kinematics import forward_kinematics
from ikgrad.plots.film import save_film
from ikgrad.plots.style import INK, new_figure, styled
from ikgrad.plots.tubes import Mesh, ball, shadow, tube
from ikgrad.robot import Robot
from ikgrad.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ARMS = ((0.95, 0.55, 0.15), (0.10, 0.45, 0.80), (0.20, 0.60, 0.35))  # one motion after the other
_TOUCHING, _OBSTACLE = (0.85, 0.08, 0.10), (0.45, 0.48, 0.52)
_GHOST, _CLOUD = 0.35, 0.55  # opacity


class _Scene(NamedTuple):
    """What all panels and frames share."""

    robot: Robot
    obstacles: Spheres | Capsules
    link_radius: float
    low: np.ndarray  # (3,) corners of the box that is shown
    high: np.ndarray


def arm_motion(
    robot: Robot,
    motions: Mapping[str, Trajectory],
    obstacles: Spheres | Capsules,
    *,
    link_radius: float = 0.03,
    poses: int = 7,
    view: tuple[float, float] = (22.0, -60.0),
    margin: float | None = None,
) -> Figure:
    """An arm at even times of its way among obstacles, one panel a motion; links that touch one are red.

    Links are drawn as the capsules that `ikgrad.collision` checks. Start and end are solid, what lies between is
    translucent, and the line is the tool's way. With a margin, a chart below tells how far the arm is from the nearest
    obstacle over time.

    Args:
        robot: the robot, n joint variables.
        motions: name to a single trajectory.
        obstacles: what stands around.
        link_radius: of the capsules [m].
        poses: how many poses of the arm, both ends included.
        view: elevation and azimuth of the camera [deg].
        margin: that the arm should keep [m]; without it there is no chart.
    """
    scene = _scene(robot, list(motions.values()), obstacles, link_radius)
    with styled():
        figure = new_figure((4.6 * max(len(motions), 2), 4.6 if margin is None else 6.6))
        _leave_room_at_the_right(figure)
        heights = [2.4] if margin is None else [2.4, 1.0]
        grid = figure.add_gridspec(len(heights), len(motions), height_ratios=heights)
        for k, (name, motion) in enumerate(motions.items()):
            axes = figure.add_subplot(grid[0, k], projection="3d", computed_zorder=False)
            opacity = [1.0, *[_GHOST] * (poses - 2), 1.0]
            _draw(axes, scene, _evenly(motion, poses), opacity, _tool(robot, _evenly(motion, 200)), _arm_colour(k))
            axes.set_title(name)
            axes.view_init(*view)
        if margin is not None:
            _chart(figure.add_subplot(grid[1, :]), scene, motions, margin)
    return figure


def save_motion(
    robot: Robot,
    motions: Mapping[str, Trajectory],
    obstacles: Spheres | Capsules,
    path: str | Path,
    *,
    link_radius: float = 0.03,
    frames: int = 40,
    seconds: float = 4.0,
    view: tuple[float, float] = (22.0, -60.0),
    dpi: int = 60,
    force: bool = True,
) -> Path:
    """The same as a film: a GIF in which every motion takes the same time, forever.

    Args:
        robot: the robot.
        motions: name to a single trajectory, side by side.
        obstacles: what stands around.
        path: of the GIF.
        link_radius: of the capsules [m].
        frames: pictures, about 0.3 s each to draw.
        seconds: that the film takes.
        view: elevation and azimuth of the camera [deg].
        dpi: pixels per inch.
        force: overwrite an existing file.

    Returns:
        The path.

    Raises:
        DataError: another suffix, the file exists and ``force`` is off, or it cannot be written.
    """
    check_suffix(Path(path), (".gif",))  # before the drawing, which takes a while
    scene = _scene(robot, list(motions.values()), obstacles, link_radius)
    every = {name: _evenly(motion, frames) for name, motion in motions.items()}
    pictures = (_frame(scene, every, frame, view) for frame in range(frames))
    with styled():
        return save_film(path, pictures, frame_seconds=seconds / frames, dpi=dpi, force=force)


def _frame(scene: _Scene, every: Mapping[str, Tensor], frame: int, view: tuple[float, float]) -> Figure:
    """All motions at one instant, with the way so far."""
    figure = new_figure((4.6 * max(len(every), 2), 4.6))
    _leave_room_at_the_right(figure)
    for k, (name, q) in enumerate(every.items()):
        axes = figure.add_subplot(1, len(every), k + 1, projection="3d", computed_zorder=False)
        _draw(axes, scene, q[frame : frame + 1], [1.0], _tool(scene.robot, q[: frame + 1]), _arm_colour(k))
        axes.set_title(name)
        axes.view_init(*view)
    return figure


def _scene(robot: Robot, motions: Sequence[Trajectory], obstacles: Spheres | Capsules, link_radius: float) -> _Scene:
    """The box around everything that any panel or frame shows."""
    for motion in motions:
        if motion.batch_shape:
            shape = tuple(motion.batch_shape)
            raise ConfigError(f"each motion must be a single trajectory, got a batch of shape {shape}: take one row")
    ends = [link_segments(robot, _evenly(motion, 50)).reshape(-1, 3).numpy() for motion in motions]
    round_centres = _centres(obstacles)
    radii = obstacles.radii.double().cpu().numpy()
    reach = [c + s * radii[:, None] for c in np.moveaxis(round_centres, 1, 0) for s in (-1, 1)]
    everything = np.concatenate([*ends, *reach])
    low, high = everything.min(axis=0) - 2 * link_radius, everything.max(axis=0) + 2 * link_radius
    low[2] = min(0.0, float(low[2]))
    return _Scene(robot, obstacles, link_radius, low, high)


def _evenly(motion: Trajectory, count: int) -> Tensor:
    """(count, n) joints at even times."""
    path = Trajectory(motion.times.detach().double().cpu(), motion.coefficients.detach().double().cpu())
    return path.position(path.times[0] + path.duration * torch.linspace(0, 1, count, dtype=torch.float64))


def _tool(robot: Robot, q: Tensor) -> np.ndarray:
    return forward_kinematics(robot, q)[:, :3, 3].numpy()


def _centres(obstacles: Spheres | Capsules) -> np.ndarray:
    """(K, 2, 3) both ends of the axes; of a sphere its centre, twice."""
    if isinstance(obstacles, Spheres):
        return obstacles.centers.double().cpu()[:, None].expand(-1, 2, -1).numpy()
    return obstacles.ends.double().cpu().numpy()


def _leave_room_at_the_right(figure: Figure) -> None:
    """The layout does not know how far the label of a z axis reaches."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    engine = figure.get_layout_engine()
    assert isinstance(engine, ConstrainedLayoutEngine)
    engine.set(rect=(0.0, 0.0, 0.97, 1.0))


def _arm_colour(k: int) -> tuple[float, ...]:
    return _ARMS[k % len(_ARMS)]


def _chart(axes: Any, scene: _Scene, motions: Mapping[str, Trajectory], margin: float) -> None:
    """The smallest distance between links and obstacles over time, one line a motion."""
    for k, (name, motion) in enumerate(motions.items()):
        segments = link_segments(scene.robot, _evenly(motion, 400))
        gap = 1e3 * scene.obstacles.distance(segments, scene.link_radius).amin(dim=(-2, -1)).numpy()
        axes.plot(np.linspace(0, float(motion.duration), len(gap)), gap, color=_arm_colour(k), label=name)
    axes.margins(x=0.01)
    low, high = axes.get_ylim()
    low = min(low, -0.15 * high)
    axes.set_ylim(low, high)
    axes.axhspan(low, 0.0, color=_TOUCHING, alpha=0.08, linewidth=0)
    axes.axhline(1e3 * margin, color=INK, linewidth=1.2, linestyle="--", label=f"margin {1e3 * margin:.0f} mm")
    axes.set(xlabel="time [s]", ylabel="clearance [mm]")
    axes.legend(loc="lower left")


def _draw(
    axes: Any, scene: _Scene, q: Tensor, opacity: Sequence[float], tool: np.ndarray, arm: tuple[float, ...]
) -> None:
    """Arms, obstacles, shadows and the tool's way."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    segments = link_segments(scene.robot, q)  # (P, L, 2, 3)
    touching = (scene.obstacles.distance(segments, scene.link_radius) <= 0).any(dim=-1).numpy()
    meshes, colours = [], []
    for links, hits, alpha in zip(segments.numpy(), touching, opacity, strict=True):
        for ends, hit in zip(links, hits, strict=True):
            meshes.append(_capsule(ends, scene.link_radius))
            colours.append((*(_TOUCHING if hit else arm), max(alpha, 0.6) if hit else alpha))
    solid = len(meshes)
    for ends, radius in zip(_centres(scene.obstacles), scene.obstacles.radii.tolist(), strict=True):
        meshes.append(_capsule(ends, radius))
        colours.append((*_OBSTACLE, _CLOUD))
    faces = np.concatenate([mesh.faces for mesh in meshes])
    rgba = np.concatenate([_shaded(mesh, colour) for mesh, colour in zip(meshes, colours, strict=True)])
    _box(axes, scene)
    ground = np.concatenate([shadow(mesh.faces, scene.low[2]) for mesh in meshes[solid:]])
    axes.add_collection3d(Poly3DCollection(ground, facecolors="#EDEDED", edgecolors="none", zorder=1))
    axes.add_collection3d(Poly3DCollection(faces, facecolors=rgba, edgecolors="none", zorder=4))
    axes.plot(*tool.T, color="white", linewidth=3.4, zorder=5)
    axes.plot(*tool.T, color=INK, linewidth=1.6, zorder=6)


def _capsule(ends: np.ndarray, radius: float) -> Mesh:
    """A tube with a ball at each end; a ball alone where both ends are one."""
    balls = [ball(ends[0], radius)]
    if np.linalg.norm(ends[1] - ends[0]) > 1e-6:
        balls += [tube(ends[0], ends[1], radius, radius), ball(ends[1], radius)]
    return Mesh(*(np.concatenate(columns) for columns in zip(*balls, strict=True)))


def _shaded(mesh: Mesh, colour: tuple[float, ...]) -> np.ndarray:
    rgb = (np.array(colour[:3]) * mesh.shade[:, None]).clip(0, 1)
    return np.concatenate([rgb, np.full((len(rgb), 1), colour[3])], axis=1)


def _box(axes: Any, scene: _Scene) -> None:
    """Equal scales, a plain floor, few ticks."""
    from matplotlib.ticker import MaxNLocator

    low, high = scene.low, scene.high
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.04)
    axes.patch.set_visible(False)  # else a panel hides the label of its neighbour's z axis
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_pane_color((1, 1, 1, 0))
        axis.line.set_color("#BBBBBB")
        axis._axinfo["grid"].update(color="#E8E8E8", linewidth=0.6)  # no public way to colour 3-D grids
