"""Charts of errors and counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.style import ERROR_LABEL, FAINT, PALETTE, new_figure, power, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def convergence(
    curves: Mapping[str, np.ndarray], *, threshold: float, printed: Mapping[str, int] | None = None
) -> Figure:
    """Error against iteration, one small panel per run, on a logarithmic axis.

    Args:
        curves: name to (k,) values of E.
        threshold: E0, drawn as a line.
        printed: iterations that the paper prints, drawn as a ring for comparison.
    """
    with styled():
        figure, panels = _grid(len(curves), size=(10.0, 4.9))
        longest = max(len(curve) for curve in curves.values())
        for axes, (name, curve) in zip(panels, curves.items(), strict=False):
            steps = np.arange(1, len(curve) + 1)
            axes.semilogy(steps, curve, color=PALETTE[0])
            axes.axhline(threshold, color=FAINT, linewidth=1.2, linestyle="--")
            axes.plot(len(curve), curve[-1], "o", color=PALETTE[0], markersize=6)
            text = f"{len(curve)}"
            if printed and name in printed:
                axes.plot(printed[name], threshold, "o", markersize=13, fillstyle="none", color=PALETTE[1])
                text = f"{len(curve)}  (paper {printed[name]})"
            axes.text(0.97, 0.93, text, transform=axes.transAxes, ha="right", va="top", fontsize=10)
            axes.set_title(f"motion {name}", loc="left")
            axes.set(xlim=(0, longest * 1.06), ylim=(threshold / 8, 40), yticks=[1e-9, 1e-6, 1e-3, 1])
        _outer_labels(panels[: len(curves)], "iteration", ERROR_LABEL)
        _key(panels[len(curves)] if len(panels) > len(curves) else panels[0], threshold, bool(printed))
    return figure


def learning_rates(
    curves: Mapping[float, np.ndarray],
    finals: Mapping[float, np.ndarray],
    *,
    threshold: float,
    limit: int,
    title: str = "",
) -> Figure:
    """What the learning rate does: curves of one run, and the error that is left after so many iterations.

    Args:
        curves: learning rate to (k,) values of E, of one run.
        finals: learning rate to the values of E left after ``limit`` iterations, one per run.
        threshold: E0, drawn as a line.
        limit: iterations shown, the paper's I0.
        title: of the left panel.
    """
    with styled():
        figure = new_figure((10.0, 4.2))
        left, right = figure.subplots(1, 2, sharey=True)
        for colour, (rate, curve) in zip(PALETTE, curves.items(), strict=False):
            shown = curve[:limit]
            left.semilogy(np.arange(1, len(shown) + 1), shown, color=colour, linewidth=1.6)
            left.plot(len(shown), shown[-1], "o", color=colour, markersize=5)
            for k, value in enumerate(np.sort(finals[rate])):
                right.plot(
                    rate * 1.05 ** (k - (len(finals[rate]) - 1) / 2),
                    value,
                    "o",
                    color=colour,
                    markersize=7,
                    markeredgecolor="white",
                )
            left.plot([], [], color=colour, label=f"{rate:g}")
        for axes in (left, right):
            axes.axhline(threshold, color=FAINT, linewidth=1.2, linestyle="--")
        left.set(xlabel="iteration", ylabel=ERROR_LABEL, title=title, xlim=(0, limit * 1.02))
        left.legend(title="learning rate", ncols=1, loc="lower left", bbox_to_anchor=(0.0, 0.08))
        right.set(xlabel="learning rate [-]", title=f"E after at most {limit} iterations, every motion", xscale="log")
        right.set_xticks(list(finals), [f"{rate:g}" for rate in finals])
        right.minorticks_off()
        right.text(1.0, threshold, "E0 ", ha="right", va="bottom", color=FAINT, transform=right.get_yaxis_transform())
    return figure


def comparison_bars(ours: Mapping[str, float], theirs: Mapping[str, float], *, ylabel: str) -> Figure:
    """Two bars per name, ours and the paper's, with their values.

    Args:
        ours: name to value.
        theirs: the same names.
        ylabel: quantity and unit.
    """
    with styled():
        figure = new_figure((8.0, 3.8))
        axes = figure.subplots()
        x = np.arange(len(ours))
        for shift, colour, label, values in ((-0.2, PALETTE[0], "ours", ours), (0.2, PALETTE[4], "paper", theirs)):
            bars = axes.bar(x + shift, [values[name] for name in ours], 0.38, color=colour, label=label)
            axes.bar_label(bars, fmt="%g", fontsize=9)
        axes.set_xticks(x, list(ours))
        axes.set(xlabel="motion", ylabel=ylabel)
        axes.grid(visible=False, axis="x")
        axes.margins(y=0.18)  # room for the legend
        axes.legend(ncols=2, loc="upper right")
    return figure


def _grid(count: int, *, size: tuple[float, float]) -> tuple[Figure, list[Any]]:
    """A figure with panels in at most four columns, axes shared; surplus panels are blank."""
    columns = min(count, 4)
    rows = -(-count // columns)
    figure = new_figure(size if rows > 1 else (size[0], size[1] * 0.6))
    panels = list(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).flat)
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels


def _outer_labels(panels: Sequence[Any], xlabel: str, ylabel: str) -> None:
    """Labels at the left and below only; a panel above a blank one shows its ticks too."""
    _, columns = panels[0].get_subplotspec().get_gridspec().get_geometry()
    for k, axes in enumerate(panels):
        if k % columns == 0:
            axes.set_ylabel(ylabel)
        if k + columns >= len(panels):
            axes.set_xlabel(xlabel)
            axes.tick_params(labelbottom=True)


def _key(axes: Any, threshold: float, printed: bool) -> None:
    axes.plot([], [], "o-", color=PALETTE[0], label="ours, last iteration")
    if printed:
        axes.plot([], [], "o", markersize=13, fillstyle="none", color=PALETTE[1], label="paper's count")
    axes.plot([], [], "--", color=FAINT, linewidth=1.2, label=f"E0 = {power(threshold)}")
    axes.legend(loc="center" if not axes.axison else "best")
