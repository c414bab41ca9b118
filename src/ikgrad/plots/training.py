"""Charts of trainings: curves and final errors over seeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ikgrad.plots.style import FAINT, INK, PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def learning_curves(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], *, ylabel: str, worst: float = 1.0) -> Figure:
    """Error against epoch on two logarithmic axes: the median over seeds as a line, their range as a band.

    Args:
        curves: name to epochs (E,) and errors (E, S); what is not finite is left out.
        ylabel: quantity and unit.
        worst: errors above are drawn at the upper edge.
    """
    with styled():
        figure = new_figure((8.0, 4.8))
        axes = figure.subplots()
        for colour, (name, (epochs, errors)) in zip(PALETTE, curves.items(), strict=False):
            kept = np.isfinite(errors).all(axis=1)
            epochs, errors = epochs[kept], np.minimum(errors[kept], worst)
            axes.plot(epochs, np.median(errors, axis=1), color=colour, label=name)
            axes.fill_between(epochs, errors.min(axis=1), errors.max(axis=1), color=colour, alpha=0.18, linewidth=0)
            lost = np.flatnonzero(~kept)
            if len(lost):
                axes.plot(epochs[-1], np.median(errors[-1]), "x", color=colour, markersize=9, markeredgewidth=2)
        axes.set(xscale="log", yscale="log", xlabel="epoch", ylabel=ylabel)
        axes.set_xlim(left=1)
        axes.legend(ncols=2, loc="lower left")
        axes.set_title("median and range over the seeds; a cross ends a curve that is not finite any more", fontsize=10)
    return figure


def spread(
    groups: Mapping[str, Mapping[str, np.ndarray]],
    *,
    ylabel: str,
    reference: Mapping[str, float] | None = None,
    reference_label: str = "",
) -> Figure:
    """Final errors of every seed as dots, one column a name, one panel a group, on a logarithmic axis.

    Args:
        groups: title of the panel to name to errors (S,).
        ylabel: quantity and unit.
        reference: name to a value drawn as a bar across its column, in the first panel.
        reference_label: what it is.
    """
    with styled():
        figure = new_figure((9.0, 4.2))
        panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axes, (title, columns) in zip(panels, groups.items(), strict=True):
            for k, (colour, values) in enumerate(zip(PALETTE, columns.values(), strict=False)):
                shift = np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.zeros(1)
                axes.plot(k + shift, np.sort(values), "o", color=colour, markersize=4)
                axes.plot([k - 0.3, k + 0.3], [np.median(values)] * 2, color=colour, linewidth=2)
            axes.set_xticks(range(len(columns)), list(columns))
            axes.set(title=title, yscale="log", xlabel="rule")
            axes.grid(visible=False, axis="x")
        for name, value in (reference or {}).items():
            names = list(next(iter(groups.values())))
            if name in names:
                place = names.index(name)
                panels[0].plot([place - 0.4, place + 0.4], [value] * 2, color=INK, linewidth=1.4, linestyle="--")
        if reference:
            panels[0].plot([], [], color=INK, linewidth=1.4, linestyle="--", label=reference_label)
        panels[0].plot([], [], "o", color=FAINT, markersize=4, label="one seed; bar: median")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        panels[0].set_ylabel(ylabel)
    return figure


def performance(
    curves: Mapping[str, np.ndarray],
    targets: np.ndarray,
    answers: np.ndarray,
    *,
    ylabel: str,
    pair_unit: str,
    note: str = "",
    mark: tuple[float, float, str] | None = None,
    title: str = "",
) -> Figure:
    """How well a network has learnt: its error at every epoch, and what it answers to what it should.

    Args:
        curves: name to errors (E, S) at epochs 1 to E; drawn as the median over the seeds, their range as a band.
        targets: (N, n), one colour for each of the n columns.
        answers: (N, n).
        ylabel: of the errors, quantity and unit.
        pair_unit: of targets and answers.
        note: in their panel.
        mark: epoch and error of somebody else, drawn as a ring, and whose.
        title: above the figure.
    """
    with styled():
        figure = new_figure((10.0, 4.6))
        left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
        for k, (colour, (name, errors)) in enumerate(zip(PALETTE, curves.items(), strict=False)):
            epochs = np.arange(1, len(errors) + 1)
            left.plot(epochs, np.median(errors, axis=1), "--" if k else "-", color=colour, label=name)
            left.fill_between(epochs, errors.min(axis=1), errors.max(axis=1), color=colour, alpha=0.15, linewidth=0)
        if mark is not None:
            left.plot(*mark[:2], "o", markersize=13, fillstyle="none", color=INK, markeredgewidth=1.6, label=mark[2])
        left.set(yscale="log", xlabel="epoch", ylabel=ylabel)
        left.margins(x=0.03)
        left.set_title("median and range over the seeds", fontsize=10)
        left.legend(loc="best")
        ends = np.array([min(targets.min(), answers.min()), max(targets.max(), answers.max())])
        right.plot(ends, ends, color=FAINT, linewidth=1.0)
        for k, colour in zip(range(targets.shape[1]), PALETTE, strict=False):
            right.plot(targets[:, k], answers[:, k], ".", color=colour, markersize=2.5, label=f"$q_{k + 1}$")
        right.set(xlabel=f"target [{pair_unit}]", ylabel=f"answer [{pair_unit}]", aspect="equal")
        right.set_title("test rows of the median seed", fontsize=10)
        right.text(0.97, 0.05, note, transform=right.transAxes, ha="right", fontsize=10)
        right.legend(markerscale=4, fontsize=9, labelspacing=0.2, handletextpad=0.1)
        if title:
            figure.suptitle(title, fontsize=11)
    return figure
