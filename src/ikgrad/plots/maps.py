"""A workspace map: cuts through it, and its shell in space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ikgrad.plots.style import new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AXES = ("x", "y", "z")
_PLANES = ((0, 2, 1), (1, 2, 0), (0, 1, 2))  # across, up, and the axis that is cut
_SHARE, _CONDITION = "viridis", "magma_r"
_WORST = 100.0  # condition numbers above are drawn as this


def workspace_map(
    centres: np.ndarray, share: np.ndarray, condition: np.ndarray, *, cell: float | None = None, title: str = ""
) -> Figure:
    """Three cuts of the share of orientations reached, the condition number in two of them, and a view in space.

    Cells that are never reached stay white. The view shows the shell of the cells reached, opened at the front.

    Args:
        centres: (C, 3) of the cells [m], multiples of ``cell``, around the shoulder.
        share: (C,) of the orientations that are reached.
        condition: (C,) smallest condition numbers.
        cell: edge of a cell [m]; default: the smallest distance between centres.
        title: above all.

    Example:
        >>> import ikgrad as ik
        >>> found = ik.reachability(ik.load_robot("ur5e"), cell=0.4, orientations=1)
        >>> figure = workspace_map(found.centres.numpy(), found.share.numpy(), found.condition.numpy())
        >>> figure.axes[0].get_xlabel()
        'x [m]'
    """
    import matplotlib

    size = cell if cell is not None else _smallest_gap(centres)
    cells = _Cells(np.rint(centres / size).astype(int), size)
    reached = np.where(share > 0, share, np.nan)
    finite = np.where(np.isfinite(condition), condition, np.nan)
    norms = matplotlib.colors.Normalize(0, 1), matplotlib.colors.LogNorm(1, _WORST)
    with styled():
        figure = new_figure((13.0, 8.6))
        figure.suptitle(title)
        rows: Any = figure.subfigures(2, 1)
        above, below = rows
        left, right = below.subfigures(1, 2, width_ratios=[2.15, 1])
        cuts = _Cuts(cells, cells.cut_at(share))
        cuts.draw(above, reached, _PLANES, _SHARE, norms[0]).set_label("share of orientations reached [-]")
        cuts.draw(left, finite, _PLANES[::2], _CONDITION, norms[1]).set_label("smallest condition number [-]")
        _shell(right.add_subplot(projection="3d"), cells, reached, cuts.at)
    return figure


def _smallest_gap(centres: np.ndarray) -> float:
    """Between centres that are multiples of it; 1 for a single cell, which has none."""
    gaps = np.concatenate([np.diff(np.unique(x.round(9))) for x in centres.T])
    return float(gaps.min()) if len(gaps) else 1.0


class _Cells(NamedTuple):
    """Cells of a lattice."""

    lattice: np.ndarray  # (C, 3) whole numbers
    size: float  # [m]

    def cut_at(self, share: np.ndarray) -> np.ndarray:
        """(3,) lattice numbers of the planes: through the middle, and level where most is reached."""
        low = self.lattice.min(axis=0)
        middle = (low + self.lattice.max(axis=0)) // 2
        levels = np.bincount(self.lattice[:, 2] - low[2], weights=share)
        middle[2] = int(levels.argmax()) + low[2]
        return middle


class _Cuts(NamedTuple):
    """Planes of cells as images."""

    cells: _Cells
    at: np.ndarray  # (3,) lattice numbers where they are

    def draw(self, figure: Any, values: np.ndarray, planes: Any, colours: str, norm: Any) -> Any:
        """Panels side by side, and one colour bar, which is returned."""
        panels = figure.subplots(1, len(planes))
        for axes, plane in zip(panels, planes, strict=True):
            drawn = self._panel(axes, values, plane, colours, norm)
        extend = "max" if norm.vmax == _WORST else "neither"
        return figure.colorbar(drawn, ax=list(panels), shrink=0.9, pad=0.02, extend=extend)

    def _panel(self, axes: Any, values: np.ndarray, plane: tuple[int, int, int], colours: str, norm: Any) -> Any:
        across, up, cut = plane
        index, size = self.cells
        low, high = index.min(axis=0), index.max(axis=0)
        here = index[:, cut] == self.at[cut]
        image = np.full((high[up] - low[up] + 1, high[across] - low[across] + 1), np.nan)
        image[index[here, up] - low[up], index[here, across] - low[across]] = values[here]
        ends = [size * x for x in (low[across] - 0.5, high[across] + 0.5, low[up] - 0.5, high[up] + 0.5)]
        axes.set_title(f"{_AXES[cut]} = {size * self.at[cut]:.3g} m")
        axes.set_xlabel(f"{_AXES[across]} [m]")
        axes.set_ylabel(f"{_AXES[up]} [m]")
        axes.grid(False)
        axes.locator_params(nbins=5)
        return axes.imshow(image, origin="lower", extent=ends, cmap=colours, norm=norm, interpolation="nearest")


def _shell(axes: Any, cells: _Cells, share: np.ndarray, at: np.ndarray) -> None:
    """Cells that can be seen once the quarter in front is taken away."""
    index, size = cells
    kept = np.isfinite(share) & ~((index[:, 0] > at[0]) & (index[:, 1] < at[1]))
    places = {tuple(place) for place in index[kept].tolist()}
    sides = ((1, 0, 0), (0, -1, 0), (0, 0, 1))
    seen = [k for k in np.flatnonzero(kept) if any(tuple(index[k] + side) not in places for side in sides)]
    width = np.ptp(index, axis=0) + 1
    x, y, z = size * index[seen].T
    style: Any = {"cmap": _SHARE, "vmin": 0, "vmax": 1, "marker": "s", "linewidths": 0, "depthshade": False}
    axes.scatter(x, y, z, c=share[seen], s=(240 / width.max()) ** 2, **style)
    axes.set_box_aspect(width, zoom=0.85)
    axes.view_init(24, -52)
    axes.locator_params(nbins=5)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    axes.set_title("share reached, cut open")
