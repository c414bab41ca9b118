"""A workspace map: cuts through it, and its shell in space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ikgrad.plots.style import new_figure, styled
from ikgrad.workspace.bounds import reach

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ikgrad.workspace.result import WorkspaceMap

_AXES = ("x", "y", "z")
_PLANES = ((0, 2, 1), (1, 2, 0), (0, 1, 2))  # across, up, and the axis that is cut
_SHARE, _CONDITION = "viridis", "magma_r"
_WORST = 100.0  # condition numbers above are drawn as this


def workspace_map(found: WorkspaceMap) -> Figure:
    """Three cuts of the share of orientations reached, the condition number in two of them, and a view in space.

    Cells that are never reached stay white. The view shows the shell of the cells reached, opened at the front.

    Args:
        found: a map.
    """
    import matplotlib

    share = np.where(found.share.numpy() > 0, found.share.numpy(), np.nan)
    condition = np.where(np.isfinite(found.condition.numpy()), found.condition.numpy(), np.nan)
    norms = matplotlib.colors.Normalize(0, 1), matplotlib.colors.LogNorm(1, _WORST)
    tried = f"{len(found.orientations)} orientations" if any(found.mask[3:]) else "position only"
    with styled():
        figure = new_figure((13.0, 8.6))
        figure.suptitle(f"{found.robot.name}: {len(found.centres):,} cells of {100 * found.cell:g} cm, {tried}")
        rows: Any = figure.subfigures(2, 1)
        above, below = rows
        left, right = below.subfigures(1, 2, width_ratios=[2.15, 1])
        cuts = _Cuts(found, _cut_at(found))
        cuts.draw(above, share, _PLANES, _SHARE, norms[0]).set_label("share of orientations reached [-]")
        cuts.draw(left, condition, _PLANES[::2], _CONDITION, norms[1]).set_label("smallest condition number [-]")
        _shell(right.add_subplot(projection="3d"), found, share, cuts.centre)
    return figure


def _cut_at(found: WorkspaceMap) -> np.ndarray:
    """(3,) lattice numbers of the planes: through the shoulder, and level where most is reached."""
    index = _lattice(found)
    centre = np.rint(reach(found.robot).shoulder / found.cell).astype(int)
    centre = np.clip(centre, index.min(axis=0), index.max(axis=0))
    levels = np.bincount(index[:, 2] - index[:, 2].min(), weights=found.share.numpy())
    centre[2] = int(levels.argmax()) + index[:, 2].min()
    return centre


def _lattice(found: WorkspaceMap) -> np.ndarray:
    return np.rint(found.centres.numpy() / found.cell).astype(int)


class _Cuts(NamedTuple):
    """Planes of cells as images."""

    found: WorkspaceMap
    centre: np.ndarray  # (3,) lattice numbers where they are

    def draw(self, figure: Any, values: np.ndarray, planes: Any, colours: str, norm: Any) -> Any:
        """Panels side by side, and one colour bar, which is returned."""
        panels = figure.subplots(1, len(planes))
        for axes, plane in zip(panels, planes, strict=True):
            drawn = self._panel(axes, values, plane, colours, norm)
        extend = "max" if norm.vmax == _WORST else "neither"
        return figure.colorbar(drawn, ax=list(panels), shrink=0.9, pad=0.02, extend=extend)

    def _panel(self, axes: Any, values: np.ndarray, plane: tuple[int, int, int], colours: str, norm: Any) -> Any:
        across, up, cut = plane
        index, cell = _lattice(self.found), self.found.cell
        low, high = index.min(axis=0), index.max(axis=0)
        here = index[:, cut] == self.centre[cut]
        image = np.full((high[up] - low[up] + 1, high[across] - low[across] + 1), np.nan)
        image[index[here, up] - low[up], index[here, across] - low[across]] = values[here]
        ends = [cell * x for x in (low[across] - 0.5, high[across] + 0.5, low[up] - 0.5, high[up] + 0.5)]
        axes.set_title(f"{_AXES[cut]} = {cell * self.centre[cut]:.3g} m")
        axes.set_xlabel(f"{_AXES[across]} [m]")
        axes.set_ylabel(f"{_AXES[up]} [m]")
        axes.grid(False)
        axes.locator_params(nbins=5)
        return axes.imshow(image, origin="lower", extent=ends, cmap=colours, norm=norm, interpolation="nearest")


def _shell(axes: Any, found: WorkspaceMap, share: np.ndarray, centre: np.ndarray) -> None:
    """Cells that can be seen once the quarter in front is taken away."""
    index = _lattice(found)
    kept = np.isfinite(share) & ~((index[:, 0] > centre[0]) & (index[:, 1] < centre[1]))
    places = {tuple(place) for place in index[kept].tolist()}
    sides = ((1, 0, 0), (0, -1, 0), (0, 0, 1))
    seen = [k for k in np.flatnonzero(kept) if any(tuple(index[k] + side) not in places for side in sides)]
    x, y, z = found.centres.numpy()[seen].T
    size = (240 * found.cell / np.ptp(found.centres.numpy(), axis=0).max()) ** 2
    style: Any = {"cmap": _SHARE, "vmin": 0, "vmax": 1, "marker": "s", "linewidths": 0, "depthshade": False}
    axes.scatter(x, y, z, c=share[seen], s=size, **style)
    axes.set_box_aspect(np.maximum(np.ptp(found.centres.numpy(), axis=0), found.cell), zoom=0.85)
    axes.view_init(24, -52)
    axes.locator_params(nbins=5)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    axes.set_title("share reached, cut open")
