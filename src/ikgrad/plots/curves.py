"""Curves of several trainings over each other: the median as a line, the range as a band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ikgrad.plots.style import INK, PALETTE, calm_log, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLES = ("-", "--", ":")


class Curve(NamedTuple):
    """One training: values y (k,) at ascending places x (k,)."""

    x: np.ndarray
    y: np.ndarray


class Group(NamedTuple):
    """Trainings that differ by the seed.

    Attributes:
        name: what tells them from other groups; empty if there is one group.
        lines: name of a quantity to its curves, one a training.
    """

    name: str
    lines: Mapping[str, Sequence[Curve]]


def on_one_axis(curves: Sequence[Curve]) -> tuple[np.ndarray, np.ndarray]:
    """All curves at the places of any of them: x (k,) and y (k, S), NaN beyond the ends of a curve.

    Example:
        >>> x, y = on_one_axis([Curve(np.array([1.0, 3.0]), np.array([4.0, 2.0])), Curve(np.array([2.0]), np.ones(1))])
        >>> x.tolist(), y[:, 0].tolist(), y[:, 1].tolist()
        ([1.0, 2.0, 3.0], [4.0, 3.0, 2.0], [nan, 1.0, nan])
    """
    x = np.unique(np.concatenate([curve.x for curve in curves]))
    y = [np.interp(x, curve.x, curve.y, left=np.nan, right=np.nan) for curve in curves if len(curve.x)]
    return x, np.stack(y, axis=1)


def curve_panels(
    groups: Sequence[Group], panels: Mapping[str, Sequence[str]], *, xlabel: str, title: str = ""
) -> Figure:
    """One panel a list of quantities; a colour a group, a dash a quantity.

    Values are logarithmic, places too where they span two decades.

    Args:
        groups: at most seven.
        panels: label of the panel, quantity and unit, to the quantities in it.
        xlabel: of what the x of the curves is.
        title: above all.

    Example:
        >>> curve = Curve(np.arange(1.0, 9.0), np.linspace(1.0, 0.1, 8))
        >>> figure = curve_panels([Group("", {"loss": [curve, curve]})], {"loss [-]": ["loss"]}, xlabel="epoch")
        >>> len(figure.axes[0].collections)  # bands
        1
    """
    from matplotlib.lines import Line2D

    with styled():
        figure = new_figure((8.0, 1.2 + 3.2 * len(panels)))
        all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (label, quantities) in zip(all_axes, panels.items(), strict=True):
            for colour, group in zip(PALETTE, groups, strict=False):
                for style, quantity in zip(_STYLES, quantities, strict=False):
                    if quantity in group.lines:
                        x, y = on_one_axis(group.lines[quantity])
                        axes.plot(x, np.nanmedian(y, axis=1), style, color=colour)
                        if y.shape[1] > 1:
                            axes.fill_between(
                                x, np.nanmin(y, axis=1), np.nanmax(y, axis=1), color=colour, alpha=0.18, linewidth=0
                            )
            axes.set(yscale="log", ylabel=label)
            calm_log(axes.yaxis)
            for style, quantity in zip(_STYLES, quantities, strict=False):
                if any(quantity in group.lines for group in groups):
                    axes.plot([], [], style, color=INK, label=quantity)
            axes.legend(loc="upper right")
        if len(groups) > 1:
            handles = [Line2D([], [], color=colour) for colour, _ in zip(PALETTE, groups, strict=False)]
            figure.legend(handles, [group.name for group in groups], loc="outside lower center", ncols=2)
        x = np.concatenate([curve.x for group in groups for curves in group.lines.values() for curve in curves])
        if x.min(initial=1.0, where=x > 0) * 100 <= x.max():
            all_axes[-1].set_xscale("log")
        all_axes[-1].set_xlabel(xlabel)
        figure.suptitle(title, fontsize=12)
    return figure


__all__ = ["Curve", "Group", "curve_panels", "on_one_axis"]
