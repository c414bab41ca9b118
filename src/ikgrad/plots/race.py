"""Benchmarks: how long solvers take for a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ikgrad.errors import DataError
from ikgrad.plots.style import PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = Mapping[str, Any]


def solver_times(cells: Sequence[Cell], *, title: str = "") -> Figure:
    """Time a row with its interval, one panel a robot, batch and number of threads; beside it success and ratio.

    Args:
        cells: of a report as plain values, see `ikgrad.bench.records.Cell`.
        title: above all.

    Raises:
        DataError: no cell was measured.
    """
    measured = [cell for cell in cells if cell.get("missing") is None and cell.get("mean") is not None]
    if not measured:
        raise DataError("no solver was measured, so there is nothing to draw")
    groups: dict[str, list[Cell]] = {}
    for cell in measured:
        groups.setdefault(_group(cell), []).append(cell)
    counts = [len(group) for group in groups.values()]
    with styled():
        figure = new_figure((9.0, 0.9 + sum(0.32 * count + 0.6 for count in counts)))
        panels = figure.subplots(
            len(groups), 1, sharex=True, squeeze=False, height_ratios=[count + 1.0 for count in counts]
        )[:, 0]
        for axes, (name, group) in zip(panels, groups.items(), strict=True):
            _bars(axes, group)
            axes.set_title(name, loc="left", fontsize=11)
        low, high = (pick(cell["mean"]["value"] for cell in measured) for pick in (min, max))
        panels[-1].set_xlim(1e6 * low / 2, 1e6 * high * (high / low) ** 0.45 * 6)  # room for the words
        panels[-1].set_xlabel("time a row [us], 95 % interval")
        figure.suptitle(title, fontsize=12)
    return figure


def _group(cell: Cell) -> str:
    job = "" if cell["job"] == "ik" else f", {cell['job']}"
    threads = "1 thread" if cell["threads"] == 1 else f"{cell['threads']} threads"
    return f"{cell['robot']}{job}, batch {cell['batch']:,}, {threads}"


def _bars(axes: Any, group: Sequence[Cell]) -> None:
    for place, cell in enumerate(group):
        colour = PALETTE[1] if cell["solver"] == "ikgrad" else PALETTE[0]
        value, low, high = (1e6 * cell["mean"][key] for key in ("value", "low", "high"))
        axes.errorbar(value, place, xerr=[[max(value - low, 0)], [max(high - value, 0)]], color=colour, capsize=4)
        axes.plot(value, place, "o", color=colour, markersize=7)
        axes.text(1.35 * max(value, high), place, _words(cell), va="center", fontsize=10)
    axes.set_xscale("log")
    axes.set_yticks(range(len(group)), [cell["solver"] for cell in group])
    axes.set_ylim(len(group) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def _words(cell: Cell) -> str:
    value = 1e6 * cell["mean"]["value"]
    parts = [f"{value:,.0f} us" if value >= 100 else f"{value:.3g} us"]
    ratio = cell.get("ratio")
    if ratio is not None and cell["solver"] != "ikgrad":
        parts.append(f"{ratio['value']:,.3g} x ours")
    if cell.get("success") is not None:
        parts.append(f"{100 * cell['success']:.4g} % solved")
    return ", ".join(parts)


__all__ = ["solver_times"]
