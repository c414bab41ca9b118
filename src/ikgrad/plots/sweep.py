"""An arm swept along its path among spheres: link lines in space, as a figure and as an animation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.files.places import check_suffix
from ikgrad.plots.film import save_film
from ikgrad.plots.style import FAINT, INK, PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRUE, PREDICTED, TOUCHING = PALETTE[0], PALETTE[4], PALETTE[1]
VIEW = (22.0, -60.0)


def swept_arm(
    links: np.ndarray,
    *,
    predicted: np.ndarray,
    touching: np.ndarray,
    touching_predicted: np.ndarray,
    centers: np.ndarray,
    radii: np.ndarray,
    unit: str = "m",
    title: str = "",
    view: tuple[float, float] = VIEW,
) -> Figure:
    """Arms at several instants, true links and predicted ones; those that meet a sphere in another colour.

    Args:
        links: (T, L, 2, 3) both ends of every true link.
        predicted: (T, L, 2, 3) of every predicted link, dashed.
        touching: (T, L) bool, whether a true link meets a sphere.
        touching_predicted: (T, L) bool, the same of the predicted ones.
        centers: (K, 3) of the spheres.
        radii: (K,)
        unit: of all lengths.
        title: above the figure.
        view: elevation and azimuth of the camera [deg].

    Example:
        >>> links = np.array([[[[0.0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 1, 1]]]])
        >>> hit = np.array([[False, True]])
        >>> figure = swept_arm(links, predicted=links, touching=hit, touching_predicted=hit,
        ...     centers=np.array([[1.0, 1, 1]]), radii=np.array([0.2]))
        >>> figure.axes[0].get_xlabel()
        'x [m]'
    """
    with styled():
        figure = new_figure((8.0, 6.2))
        axes = _space(figure, np.concatenate([links, predicted]).reshape(-1, 3), centers, radii, unit, view, 0.95)
        hand = links[:, -1, 1]
        axes.plot(*hand.T, color=FAINT, linewidth=1.0)
        _lines(axes, links, touching, TRUE, linewidth=2.2, alpha=0.75)
        _lines(axes, predicted, touching_predicted, PREDICTED, linewidth=1.4, linestyle="--")
        _key(axes)
        figure.suptitle(title, fontsize=11)
    return figure


def save_sweep(
    path: str | Path,
    links: np.ndarray,
    *,
    predicted: np.ndarray,
    touching: np.ndarray,
    centers: np.ndarray,
    radii: np.ndarray,
    unit: str = "m",
    size: tuple[float, float] = (5.2, 3.9),
    dpi: int = 80,
    frames_per_second: int = 15,
    view: tuple[float, float] = VIEW,
) -> Path:
    """An animation of one motion as a GIF that repeats: the true arm, the predicted one, and the way of the hand.

    Args:
        path: where to; ends in ``.gif``, an existing file is overwritten in one move.
        links: (T, L, 2, 3) both ends of every true link, one frame an instant.
        predicted: (T, L, 2, 3) of every predicted link.
        touching: (T, L) bool, links to be drawn as touching: true ones that meet a sphere.
        centers: (K, 3) of the spheres.
        radii: (K,)
        unit: of all lengths.
        size: of a frame [inch].
        dpi: pixels per inch.
        frames_per_second: speed.
        view: elevation and azimuth of the camera [deg].

    Returns:
        The path.

    Raises:
        DataError: another suffix, or it cannot be written.
    """
    check_suffix(Path(path), (".gif",))  # before the drawing, which takes a while
    with styled():
        figure = new_figure(size)
        figure.set_layout_engine(None)
        figure.subplots_adjust(left=0.0, right=1.0, bottom=0.06, top=1.02)
        axes = _space(figure, np.concatenate([links, predicted]).reshape(-1, 3), centers, radii, unit, view, 1.0)
        hand = links[:, -1, 1]
        (way,) = axes.plot([], [], [], color=FAINT, linewidth=1.0)

        def pictures() -> Iterator[Figure]:
            for k in range(len(links)):
                now = slice(k, k + 1)
                way.set_data_3d(*hand[: k + 1].T)
                calm = np.zeros_like(touching[now])
                arms = _lines(axes, links[now], touching[now], TRUE, linewidth=3.0)
                arms += _lines(axes, predicted[now], calm, PREDICTED, linewidth=1.4, linestyle="--")
                yield figure
                for artist in arms:
                    artist.remove()

        return save_film(path, pictures(), frame_seconds=1 / frames_per_second, dpi=dpi)


def _space(
    figure: Figure,
    xyz: np.ndarray,
    centers: np.ndarray,
    radii: np.ndarray,
    unit: str,
    view: tuple[float, float],
    zoom: float,
) -> Any:
    """Axes of equal scale that hold all points and spheres, with the spheres in them."""
    from matplotlib.ticker import MaxNLocator

    axes = figure.add_subplot(projection="3d")
    low = np.minimum(xyz.min(axis=0), (centers - radii[:, None]).min(axis=0))
    high = np.maximum(xyz.max(axis=0), (centers + radii[:, None]).max(axis=0))
    pad = 0.03 * (high - low).max()
    low, high = low - pad, high + pad
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=zoom)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]", zlabel=f"z [{unit}]")
    axes.view_init(*view)
    turn, tilt = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=0)
    for center, radius in zip(centers, radii, strict=True):
        x, y, z = center[:, None, None] + radius * ball
        axes.plot_surface(x, y, z, color=PALETTE[2], alpha=0.45, linewidth=0)
    axes.plot(0, 0, 0, "s", color=INK, markersize=6)
    return axes


def _lines(axes: Any, links: np.ndarray, touching: np.ndarray, colour: str, **style: Any) -> list[Any]:
    """All links as two collections, those that touch and those that do not."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    drawn = []
    for which, shade in ((~touching, colour), (touching, TOUCHING)):
        if which.any():
            drawn.append(axes.add_collection3d(Line3DCollection(links[which], colors=shade, **style), autolim=False))
    return drawn


def _key(axes: Any) -> None:
    axes.plot([], [], [], color=TRUE, label="true links")
    axes.plot([], [], [], "--", color=PREDICTED, label="predicted links")
    axes.plot([], [], [], color=TOUCHING, label="judged to meet the sphere")
    axes.legend(loc="upper left", fontsize=9)


__all__ = ["save_sweep", "swept_arm"]
