"""Evaluations as they are recorded: methods side by side, by percentiles and by time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ikgrad.plots.style import FAINT, INK, PALETTE, calm_log, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Record = Mapping[str, Any]

_UNITS = {"position_mm": "position error [mm]", "rotation_deg": "rotation error [deg]"}
_LEAST = {"position_mm": 1e-9, "rotation_deg": 1e-10}  # smaller errors are drawn here
_MARKERS = (("o", "median"), ("s", "95 %"), ("|", "99.9 %"))


def method_errors(records: Sequence[Record], *, title: str = "") -> Figure:
    """Median, 95th and 99.9th percentile of every method, one panel a protocol.

    Args:
        records: of evaluations, see `ikgrad.evaluation.Evaluation.record`.
        title: above all.
    """
    counts = [len(record["rows"]) for record in records]
    with styled():
        figure = new_figure((11.0, 0.9 + sum(0.27 * count + 0.55 for count in counts)))
        panels = figure.subplots(
            len(records), 2, sharex="col", sharey="row", squeeze=False, height_ratios=[count + 1.2 for count in counts]
        )
        for record, axes in zip(records, panels, strict=True):
            for panel, unit in zip(axes, _UNITS, strict=True):
                _whiskers(panel, record["rows"], unit)
            axes[0].set_yticks(range(len(record["rows"])), [row["method"] for row in record["rows"]])
            axes[0].set_title(_name(record), loc="left", fontsize=11)
            axes[0].set_ylim(len(record["rows"]) - 0.5, -0.5)
        for panel, label in zip(panels[-1], _UNITS.values(), strict=True):
            panel.set_xlabel(label)
        for marker, name in _MARKERS:
            panels[0, 0].plot([], [], marker, color=INK, markersize=7, markeredgewidth=2, label=name)
        figure.legend(loc="outside upper center", ncols=3, title=title, title_fontsize=13)
    return figure


def _whiskers(axes: Any, rows: Sequence[Record], unit: str) -> None:
    for place, row in enumerate(rows):
        colour = _colour(row)
        values = [max(_LEAST[unit], np.inf if value is None else value) for value in row["errors"][unit]]
        drawn = [value for value in values if np.isfinite(value)]
        axes.plot(drawn, [place] * len(drawn), color=colour, linewidth=1.6)
        for (marker, _), value in zip(_MARKERS, values, strict=False):
            if np.isfinite(value):
                axes.plot(value, place, marker, color=colour, markersize=7, markeredgewidth=2)
    axes.set_xscale("log")
    axes.grid(visible=False, axis="y")


def method_speed(records: Sequence[Record], *, title: str = "") -> Figure:
    """The 95th percentile of the position error against the time a pose, one panel a protocol that asks the inverter.

    Args:
        records: of evaluations.
        title: above all.
    """
    records = [record for record in records if any(_kind(row) == "inverter" for row in record["rows"])]
    columns = max(min(len(records), 3), 1)
    lines = max(-(-len(records) // columns), 1)
    with styled():
        figure = new_figure((4.4 * columns + 0.6, 3.7 * lines + 0.8))
        panels = list(figure.subplots(lines, columns, squeeze=False).flat)
        for axes, record in zip(panels, records, strict=False):
            for kind, (label, colour, style) in _KINDS.items():
                rows = [row for row in record["rows"] if _kind(row) == kind]
                times, errors = _times_and_errors(rows)
                axes.plot(times, errors, style, color=colour, linewidth=1.2, label=label)
            axes.set(xscale="log", yscale="log", xlabel="time a pose [us]", ylabel="position error, 95 % [mm]")
            axes.set_title(record.get("protocol") or record["task"], loc="left", fontsize=11)
            calm_log(axes.xaxis)
            calm_log(axes.yaxis)
        for axes in panels[len(records) :]:
            axes.set_axis_off()
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        figure.suptitle(title, fontsize=13)
    return figure


_KINDS = {
    "inverter": ("the inverter, then with solver steps", PALETTE[1], "o-"),
    "plain": ("plain solver steps", PALETTE[0], "s-"),
    "solver": ("solve_ik", INK, "D"),
}


def _kind(row: Record) -> str:
    if row["method"].startswith("inverter"):
        return "inverter"
    return "solver" if row["method"].startswith("solve_ik") else "plain"


def _times_and_errors(rows: Sequence[Record]) -> tuple[list[float], list[float]]:
    """Times a pose [us] and 95th percentiles [mm] in the order of time; what is not finite is left out."""
    pairs = [(row["microseconds"], row["errors"]["position_mm"][1]) for row in rows]
    kept = sorted((time, max(error, _LEAST["position_mm"])) for time, error in pairs if error is not None)
    return [time for time, _ in kept], [error for _, error in kept]


def _colour(row: Record) -> str:
    return {"inverter": PALETTE[1], "plain": FAINT, "solver": PALETTE[0]}[_kind(row)]


def _name(record: Record) -> str:
    protocol, task = record.get("protocol", ""), record["task"]
    count = f"{record['count']:,} rows" if "count" in record else ""
    return ", ".join(part for part in (task if task.startswith(protocol) else f"{protocol}: {task}", count) if part)


__all__ = ["method_errors", "method_speed"]
