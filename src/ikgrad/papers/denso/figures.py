"""Figures 4, 6 and 11 to 14 of the paper from our own runs, and the closed loop, which the paper leaves out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ikgrad import plots
from ikgrad.papers.denso.networks import NetworkResult
from ikgrad.papers.denso.study import DensoStudy
from ikgrad.papers.printed import find_row, numbers, read_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXES = ("x", "y", "z")
PAPER = {"traditional": "traditional", "feedback": "proposed"}
SECONDS = 30.0  # the paper shows pieces of its helix up to second 30, so that is how long ours is said to take
ENLARGED = 50.0


def figure4(study: DensoStudy) -> Figure:
    """Figure 4: the traditional network, mean squared error against epoch; with its answers against the targets."""
    return _performance(study, study.path.traditional, "Figure 4 of the paper")


def figure6(study: DensoStudy) -> Figure:
    """Figure 6: the same of the feedback network."""
    return _performance(study, study.path.feedback, "Figure 6 of the paper")


def figure11(study: DensoStudy) -> Figure:
    """Figure 11: the helix, wanted and followed, with the points i, j, k whose surroundings Figure 12 enlarges."""
    path = (1000 * study.track.path).numpy()
    curves = {"wanted": path}
    for name in ("feedback", "traditional"):
        curves[f"{name}, errors {ENLARGED:g}-fold"] = path + ENLARGED * study.track.errors_mm[name].numpy()
    times = _times(study)
    middles = [sum(window) / 2 for window in _windows()]
    points = {letter: path[np.abs(times - middle).argmin()] for letter, middle in zip("ijk", middles, strict=True)}
    title = f"Figure 11 of the paper: the gripper's path, networks of scheme D in closed loop, {_which(study)}"
    return plots.curves_in_space(curves, points=points, unit="mm", title=title)


def figure12(study: DensoStudy) -> Figure:
    """Figure 12: pieces of the three coordinates, at the paper's times."""
    wanted = (1000 * study.track.path).numpy()
    return plots.closeups(
        wanted,
        {name: wanted + study.track.errors_mm[name].numpy() for name in ("feedback", "traditional")},
        x=_times(study),
        windows=_windows(),
        panels=AXES,
        xlabel=f"time [s], the helix in {SECONDS:g} s",
        unit="mm",
        title=f"Figure 12 of the paper: pieces of the helix, networks of scheme D in closed loop, {_which(study)}",
    )


def figure13(study: DensoStudy) -> Figure:
    """Figure 13: position errors of the feedback network along the helix."""
    return _errors(study, "feedback", "Figure 13 of the paper")


def figure14(study: DensoStudy) -> Figure:
    """Figure 14: position errors of the traditional network along the helix."""
    return _errors(study, "traditional", "Figure 14 of the paper")


def drift(study: DensoStudy) -> Figure:
    """Scheme B in closed loop: position error of every seed along its own training path."""
    drift = study.path.drift.clamp(min=1e-3)
    lines = {f"seed {seed}": drift[:, seed : seed + 1].numpy() for seed in range(drift.shape[1])}
    title = f"Scheme B, {len(lines)} feedback networks fed with their own answers on the paths they were trained on"
    return plots.traces(lines, panels=["position error [mm]"], xlabel="step", log=True, title=title)


def _performance(study: DensoStudy, result: NetworkResult, figure: str) -> Figure:
    printed = find_row("denso_networks", network=PAPER[result.name])
    epoch, error = numbers(printed, "stop_epoch", "best_mse")
    mean = result.targets.mean(0)  # as in R: each joint about its own mean
    inputs = {"traditional": 6, "feedback": 12}[result.name]
    return plots.performance(
        {"training": result.curve_train.numpy(), "validation": result.curve_validation.numpy()},
        (result.targets - mean).rad2deg().numpy(),
        (result.answers - mean).rad2deg().numpy(),
        ylabel="mean squared error [rad$^2$]",
        pair_unit="deg",
        note=f"joint means taken off\nR = {result.regression[result.median_seed]:.6f}",
        mark=(epoch, error, f"paper: {printed['best_mse']} at {printed['stop_epoch']}"),
        title=f"{figure}: {result.name} network {inputs}-10-6 on scheme B, {len(result.mse)} seeds",
    )


def _errors(study: DensoStudy, name: str, figure: str) -> Figure:
    errors = study.track.errors_mm[name].numpy()
    printed = [row[f"{PAPER[name]}_max_error_mm"] for row in read_table("denso_path_errors")]
    largest = np.abs(errors).max(0)
    both = max(abs(each).max().item() for each in study.track.errors_mm.values())  # so that 13 and 14 can be compared
    return plots.traces(
        {name: errors},
        panels=[f"error in {axis} [mm]" for axis in AXES],
        x=_times(study),
        xlabel=f"time [s], the helix in {SECONDS:g} s",
        limit=1.25 * both,
        notes=[f"largest {ours:.2f} mm; paper {theirs} mm" for ours, theirs in zip(largest, printed, strict=True)],
        title=f"{figure}: {name} network of scheme D on the helix, closed loop, {_which(study)}",
    )


def _times(study: DensoStudy) -> np.ndarray:
    return np.linspace(0.0, SECONDS, len(study.track.path))


def _windows() -> list[tuple[float, float]]:
    rows = read_table("denso_path_errors")
    return [(float(row["figure12_zoom_from_s"]), float(row["figure12_zoom_to_s"])) for row in rows]


def _which(study: DensoStudy) -> str:
    return f"median of {len(study.track.feedback.mse)} seeds"


FIGURES = {
    "denso_figure04": figure4,
    "denso_figure06": figure6,
    "denso_figure11": figure11,
    "denso_figure12": figure12,
    "denso_figure13": figure13,
    "denso_figure14": figure14,
    "denso_drift": drift,
}
