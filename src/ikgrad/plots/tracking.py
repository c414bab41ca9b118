"""Charts of paths that were followed: one panel a quantity, one line a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikgrad.plots.style import PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def traces(
    lines: Mapping[str, np.ndarray],
    *,
    panels: Sequence[str],
    xlabel: str,
    log: bool = False,
    windows: Sequence[slice] | None = None,
    title: str = "",
) -> Figure:
    """Values along a path, panels one above the other.

    Args:
        lines: name to values (N, P); of two or three, later ones are dashed, so that equal ones can be told.
        panels: label of each of the P panels, quantity and unit.
        xlabel: what the rows are.
        log: logarithmic values.
        windows: rows to be shown in each panel; default: all.
        title: above the figure.
    """
    with styled():
        figure = new_figure((8.0, 1.0 + 2.1 * len(panels)))
        all_axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for p, (axes, label) in enumerate(zip(all_axes, panels, strict=True)):
            for k, (name, values) in enumerate(lines.items()):
                shown = windows[p] if windows else slice(None)
                x = np.arange(len(values))[shown]
                style = "--" if 0 < k < len(lines) <= 3 else "-"
                axes.plot(x, values[shown, p], style, color=PALETTE[k % len(PALETTE)], linewidth=1.4, label=name)
            axes.set_ylabel(label)
            if log:
                axes.set_yscale("log")
        all_axes[-1].set_xlabel(xlabel)
        if len(lines) > 1:
            all_axes[0].legend(ncols=min(len(lines), 5), fontsize=9)
        if title:
            figure.suptitle(title, fontsize=11)
    return figure


__all__ = ["traces"]
