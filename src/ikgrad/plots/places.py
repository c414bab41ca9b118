"""Where poses are, and how they are turned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.arm import draw_floor, draw_frame, frame_key
from ikgrad.plots.style import FAINT, INK, PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CROWD = 2000  # from so many points on, a density says more than dots
FRAMES = 60


def pose_places(T: np.ndarray, *, title: str = "") -> Figure:
    """Positions from above and from the side, and the angle of the tool's z axis.

    Args:
        T: (N, 4, 4) [m].
        title: above all.

    Example:
        >>> figure = pose_places(np.eye(4)[None])
        >>> [axes.get_xlabel() for axes in figure.axes]
        ['x [m]', 'distance from the z axis [m]', "tool's z axis from vertical [deg]"]
    """
    p = T[:, :3, 3]
    tilt = np.degrees(np.arccos(np.clip(T[:, 2, 2], -1.0, 1.0)))
    with styled():
        figure = new_figure((12.0, 4.4))
        above, side, turned = figure.subplots(1, 3)
        _points(above, p[:, 0], p[:, 1])
        above.plot(0, 0, "+", color=INK, markersize=12, markeredgewidth=2)
        above.set(xlabel="x [m]", ylabel="y [m]", title="from above; +: the base")
        _points(side, np.linalg.norm(p[:, :2], axis=1), p[:, 2])
        side.set(xlabel="distance from the z axis [m]", ylabel="z [m]", title="from the side")
        turned.hist(tilt, bins=np.linspace(0, 180, 37), weights=np.full(len(p), 100 / len(p)), color=PALETTE[0])
        turned.set(xlabel="tool's z axis from vertical [deg]", ylabel="poses [%]", xticks=range(0, 181, 45))
        turned.set_title("0: up, 180: down")
        figure.suptitle(title)
    return figure


def pose_frames(T: np.ndarray, *, view: tuple[float, float] = (20.0, -50.0), title: str = "") -> Figure:
    """Frames in space, at most `FRAMES` at even places among them; a line in the order of the rows.

    Args:
        T: (N, 4, 4) [m].
        view: elevation and azimuth of the camera [deg].
        title: above the figure.
    """
    shown = T[np.unique(np.linspace(0, len(T) - 1, min(len(T), FRAMES)).round().astype(int))]
    p = shown[:, :3, 3]
    with styled():
        figure = new_figure((8.0, 6.4))
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        size = 0.07 * float(np.ptp(p, axis=0).max() or 1.0)
        draw_floor(axes, p, [], margin=1.2 * size)
        axes.plot(*p.T, color=FAINT, linewidth=0.8, zorder=5)
        for frame in shown:
            draw_frame(axes, frame, size, width=2.0)
        frame_key(axes)
        axes.view_init(*view)
        rest = f", {len(shown)} of them drawn" if len(shown) < len(T) else ""
        figure.suptitle(f"{title}{rest}", fontsize=12)
    return figure


def _points(axes: Any, x: np.ndarray, y: np.ndarray) -> None:
    """Dots, or the density of a crowd."""
    if len(x) < _CROWD:
        axes.plot(x, y, ".", color=PALETTE[0], markersize=4, alpha=0.7)
    else:
        picture = axes.hexbin(x, y, gridsize=36, mincnt=1, cmap="cividis")
        axes.figure.colorbar(picture, ax=axes, label="poses a cell [-]", location="bottom", aspect=30)
    axes.set_aspect("equal")


__all__ = ["FRAMES", "pose_frames", "pose_places"]
