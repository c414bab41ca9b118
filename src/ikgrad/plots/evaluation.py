"""One page about an inverter: how large its errors are, where they are, and what the worst answers look like."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.evaluation import Evaluation, Row, RowErrors, row_errors
from ikgrad.evaluation.table import number, percent
from ikgrad.kinematics import forward_kinematics, link_poses
from ikgrad.plots.arm import AXIS_COLOURS, draw_floor, draw_frame, draw_meshes
from ikgrad.plots.histograms import draw_percentiles, log_bins, percentile_key
from ikgrad.plots.style import INK, PALETTE, new_figure, styled
from ikgrad.plots.tubes import arm_mesh
from ikgrad.plots.workspace import cells_of, draw_cells
from ikgrad.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST = {"mm": 1e-9, "deg": 1e-10}  # smaller errors are drawn here
_WORST = 3
_UNITS = {"mm": "position error [mm]", "deg": "rotation error [deg]"}


def evaluation_page(
    evaluations: Sequence[Evaluation], robot: Robot, *, title: str = "", summary: bool = True
) -> Figure:
    """Histograms of every protocol, the errors over the workspace, the worst answers, and a summary.

    Workspace and worst answers are those of the first evaluation with answers.

    Args:
        evaluations: of one inverter, see `ikgrad.evaluate`.
        robot: whose inverter it is.
        title: above all.
        summary: also a table with one line a protocol.
    """
    shown = [found for found in evaluations if found.answers is not None]
    rows = summary_cells(evaluations) if summary else []
    text = [line for remark in remarks(evaluations) for line in textwrap.wrap(remark, 165)] if summary else []
    heights = {
        "errors": max(4.4, 1.25 * len(shown) + 0.9),
        "worst": 4.3,
        "summary": 0.4 * len(rows) + 0.195 * len(text) + 0.5,
    }
    parts = [name for name in heights if (rows or text if name == "summary" else shown)]
    with styled():
        figure = new_figure((13.0, sum(heights[name] for name in parts) + 0.7))
        figure.suptitle(title, fontsize=16, fontweight="bold")
        blocks = figure.subfigures(len(parts), 1, height_ratios=[heights[name] for name in parts], squeeze=False)
        block = dict(zip(parts, blocks[:, 0], strict=True))
        if shown:
            left, right = block["errors"].subfigures(1, 2, width_ratios=(1.75, 1.0))
            _histograms(left, shown, robot)
            errors = _errors(shown[0], robot)
            _workspace(right, shown[0], robot, errors)
            _worst(block["worst"], shown[0], robot, errors)
        if rows or text:
            _summary(block["summary"], rows, text)
    return figure


def summary_cells(evaluations: Sequence[Evaluation]) -> list[list[str]]:
    """The head, and one line a protocol: the inverter alone, after solver steps, and what stands beside it.

    Protocols that judge a solver have no line; `remarks` speaks of them.
    """
    columns = [column for column in _SUMMARY if any(column[1](found) for found in evaluations)]
    lines = [[show(found) for _, show in columns] for found in evaluations if _mine(found)]
    return [[name for name, _ in columns], *lines] if lines else []


def remarks(evaluations: Sequence[Evaluation]) -> list[str]:
    """What does not fit into a line of the table: solve rates, and the notes of the protocols."""
    lines = []
    for found in evaluations:
        if not _mine(found):
            rates = ", ".join(f"{percent(row.extra['solved'])} {_start(row)}" for row in found.rows)
            times = number(found.rows[-1].extra["time_ratio"])
            lines.append(
                f"{found.protocol}: solve_ik solves {rates}; from the inverter in {times} x the time of its own starts."
            )
        elif "mean_position_mm" in found.rows[0].extra:
            errors = found.rows[0].errors
            means = f"{number(errors.mean_position_mm)} mm and {number(errors.mean_rotation_deg)} deg"
            lines.append(f"{found.protocol}: mean {means}, measured.")
        lines += [f"{found.protocol}: {text}" for text in found.notes]
    return lines


def _start(row: Row) -> str:
    """solve_ik from the inverter -> from the inverter."""
    words = row.method.removeprefix("solve_ik").lstrip(" ,")
    return words if words.startswith("from") else f"from {words}"


def _mine(found: Evaluation) -> list[Row]:
    """The inverter alone, then after solver steps."""
    return [row for row in found.rows if row.method.startswith("inverter")]


def _beside(found: Evaluation) -> str:
    other = found.rows[-1]
    label = "solve_ik" if other.method == "solve_ik" else "plain, same time"
    return f"{100 * other.errors.close:.1f} % ({label})"


def _jumps(found: Evaluation) -> str:
    extra = _mine(found)[0].extra if _mine(found) else {}
    if "largest_jump" not in extra:
        return ""
    return f"{extra['reconfigurations']:,.0f}, largest {number(extra['largest_jump'])} rad"


def _of_mine(show: Callable[[list[Row]], str]) -> Callable[[Evaluation], str]:
    return lambda found: show(_mine(found)) if _mine(found) else ""


_SUMMARY: list[tuple[str, Callable[[Evaluation], str]]] = [
    ("protocol", lambda found: found.protocol or "task"),
    ("position [mm]\n50 / 95 / 99.9 %", _of_mine(lambda rows: " / ".join(map(number, rows[0].errors.position_mm)))),
    ("rotation [deg]\n50 / 95 / 99.9 %", _of_mine(lambda rows: " / ".join(map(number, rows[0].errors.rotation_deg)))),
    (
        "within 1 mm, 0.01 rad\nafter 0, 1, 2 ... steps",
        _of_mine(lambda rows: " / ".join(f"{100 * row.errors.close:.1f}" for row in rows) + " %"),
    ),
    ("the same without\nthe inverter", _beside),
    ("reconfigurations", _jumps),
    ("us a pose", _of_mine(lambda rows: number(rows[0].microseconds))),
]


def _errors(found: Evaluation, robot: Robot) -> RowErrors:
    assert found.answers is not None
    return row_errors(robot, found.answers.q, found.answers.T_target)


def _in_units(errors: RowErrors) -> Mapping[str, np.ndarray]:
    return {"mm": (1e3 * errors.position).numpy(), "deg": errors.rotation.rad2deg().numpy()}


def _histograms(figure: Any, shown: Sequence[Evaluation], robot: Robot) -> None:
    """One row a protocol, on shared logarithmic axes, with percentiles."""
    values = [_in_units(_errors(found, robot)) for found in shown]
    panels = figure.subplots(len(shown), 2, sharex="col", squeeze=False)
    for column, unit in enumerate(_UNITS):
        bins = log_bins([np.maximum(errors[unit], _LEAST[unit]) for errors in values])
        for axes, found, errors in zip(panels[:, column], shown, values, strict=True):
            _histogram(axes, np.maximum(errors[unit], _LEAST[unit]), bins)
            if column == 0:
                axes.set_ylabel(f"{found.protocol or 'task'}\n[% of rows]")
        panels[-1, column].set_xlabel(_UNITS[unit])
    percentile_key(panels[0, 0])
    figure.legend(loc="outside upper center", ncols=3, title="errors of the inverter alone; percentiles:")


def _histogram(axes: Any, errors: np.ndarray, bins: np.ndarray) -> None:
    finite = errors[np.isfinite(errors)]
    axes.hist(finite, bins=bins, weights=np.full(len(finite), 100 / len(errors)), color=PALETTE[5])
    axes.set_xscale("log")
    draw_percentiles(axes, errors)
    lost = len(errors) - len(finite)
    if lost:
        axes.text(0.5, 0.5, f"{lost:,} rows not finite", transform=axes.transAxes, ha="center", color=PALETTE[1])


def _workspace(figure: Any, found: Evaluation, robot: Robot, errors: RowErrors) -> None:
    """Median position error by distance from the first joint's axis and by height."""
    assert found.answers is not None
    axes = figure.subplots()
    mm = np.maximum(_in_units(errors)["mm"], _LEAST["mm"])
    cells = cells_of(robot, found.answers.T_target[:, :3, 3].numpy(), mm)
    draw_cells(axes, cells, label="median position error [mm]", log=True)
    axes.set_title(f"{found.protocol or 'task'}: median error by place of the target", fontsize=11)


def _worst(figure: Any, found: Evaluation, robot: Robot, errors: RowErrors) -> None:
    """The answers that are farthest off: the arm, and the frame that it should have reached."""
    assert found.answers is not None
    order = torch.where(errors.position.isfinite(), errors.position, -1.0).argsort(descending=True)[:_WORST]
    figure.suptitle(f"{found.protocol or 'task'}: the worst answers, and the frames asked for", fontsize=12)
    for k, row in enumerate(order.tolist()):
        axes = figure.add_subplot(1, _WORST, k + 1, projection="3d", computed_zorder=False)
        _arm(axes, robot, found.answers.q[row].double(), found.answers.T_target[row].double())
        mm, deg = float(errors.position[row] * 1e3), float(errors.rotation[row].rad2deg())
        axes.text2D(0.02, 1.0, f"{number(mm)} mm, {number(deg)} deg off", fontsize=11, transform=axes.transAxes)
        if k == 0:
            for colour, name in zip(AXIS_COLOURS, "xyz", strict=True):
                axes.plot([], [], color=colour, linewidth=3, label=f"{name} asked for")
            axes.plot([], [], color=INK, linewidth=1.5, linestyle=":", label="what is missing")
    figure.legend(loc="outside lower center", ncols=4)


def _arm(axes: Any, robot: Robot, q: Tensor, T_target: Tensor) -> None:
    links = link_poses(robot.detach(), q)[:, :3, 3].numpy()
    tip, target = (T.numpy() for T in (forward_kinematics(robot.detach(), q), T_target))
    size = 0.16 * float(np.ptp(links, axis=0).max() or 1.0)
    mesh = arm_mesh(links, 0.22 * size)
    ends = target[:3, 3] + size * target[:3, :3].T
    draw_floor(axes, np.concatenate([links, tip[None, :3, 3], ends]), [mesh], margin=0.9 * size, zoom=0.95)
    draw_meshes(axes, [mesh])
    for T, width, alpha in ((tip, 1.5, 0.55), (target, 3.5, 1.0)):
        draw_frame(axes, T, size, width=width, alpha=alpha)
    axes.plot(*np.stack([tip[:3, 3], target[:3, 3]]).T, color=INK, linewidth=1.5, linestyle=":", zorder=6)
    axes.view_init(20.0, -50.0)
    axes.tick_params(labelsize=8)


def _summary(figure: Any, cells: list[list[str]], text: list[str]) -> None:
    axes = figure.subplots()
    axes.set_axis_off()
    lines = 0.195 * len(text) / (0.195 * len(text) + 0.4 * len(cells))  # share of the height
    axes.text(0.0, 0.0, "\n".join(text), va="bottom", fontsize=10, linespacing=1.35, transform=axes.transAxes)
    if not cells:
        return
    table = axes.table(cells[1:], colLabels=cells[0], cellLoc="right", bbox=(0, lines + 0.03, 1, 0.97 - lines))
    table.auto_set_font_size(False)
    table.set_fontsize(11)
    for (row, column), cell in table.get_celld().items():
        cell.visible_edges = "B" if row else "BT"
        cell.set_edgecolor("#BBBBBB")
        cell.set_text_props(ha="left" if column == 0 else "right", fontweight="normal" if row else "bold")
    table.auto_set_column_width(range(len(cells[0])))


__all__ = ["evaluation_page", "remarks", "summary_cells"]
