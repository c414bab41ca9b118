"""The figures of the study; Figures 4 and 6 in one, 11, 12, 13, 14, and the closed loop, which the paper leaves out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ikgrad import plots
from ikgrad.papers.denso.arm import denso, tool_down_ik
from ikgrad.papers.denso.study import DensoStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POSITIONS = ("x [mm]", "y [mm]", "z [mm]")


def learning(study: DensoStudy) -> Figure:
    """Figures 4 and 6: mean squared error against epoch of both networks on scheme B."""
    curves = {}
    for result in (study.path.traditional, study.path.feedback):
        epochs = np.arange(1, result.epochs + 1)
        curves[f"{result.name}, training"] = (epochs, result.curve_train.numpy())
        curves[f"{result.name}, validation"] = (epochs, result.curve_validation.numpy())
    return plots.learning_curves(curves, ylabel="mean squared error [rad$^2$]")


def path(study: DensoStudy) -> Figure:
    """Figure 11: the arm and the helix, wanted and followed."""
    track = study.track
    q = tool_down_ik(track.path[[0, len(track.path) // 2, -1]])
    paths = {"wanted": track.path.numpy(), **{name: (p / 1000).numpy() for name, p in _followed_mm(study).items()}}
    return plots.arm_path(denso(), list(q), paths=paths, legend="gripper", radius=0.02)


def closeup(study: DensoStudy) -> Figure:
    """Figure 12: coordinates along a piece of the helix, wanted and followed."""
    lines = {"wanted": (1000 * study.track.path).numpy()} | {k: v.numpy() for k, v in _followed_mm(study).items()}
    count = len(study.track.path)
    piece = slice(count // 2, count // 2 + count // 50)
    return plots.traces(lines, panels=POSITIONS, xlabel="point of the path", windows=[piece] * 3)


def feedback_errors(study: DensoStudy) -> Figure:
    """Figure 13: position errors of the feedback network in closed loop along the helix."""
    return _errors(study, "feedback")


def traditional_errors(study: DensoStudy) -> Figure:
    """Figure 14: position errors of the traditional network along the helix."""
    return _errors(study, "traditional")


def drift(study: DensoStudy) -> Figure:
    """Scheme B in closed loop: position error of every seed along its own training path."""
    drift = study.path.drift.clamp(min=1e-3)
    lines = {f"seed {seed}": drift[:, seed : seed + 1].numpy() for seed in range(drift.shape[1])}
    title = "Scheme B, feedback network fed with its own answers, on the path that it was trained on"
    return plots.traces(lines, panels=["position error [mm]"], xlabel="step", log=True, title=title)


def _followed_mm(study: DensoStudy) -> dict[str, torch.Tensor]:
    return {name: 1000 * study.track.path + error for name, error in study.track.errors_mm.items()}


def _errors(study: DensoStudy, name: str) -> Figure:
    lines = {name: study.track.errors_mm[name].numpy()}
    labels = [f"error in {label}" for label in POSITIONS]
    title = f"{name} network, trained by scheme D, closed loop, median of {len(study.track.feedback.mse)} seeds"
    return plots.traces(lines, panels=labels, xlabel="point of the path", title=title)


FIGURES = {
    "denso_learning": learning,
    "denso_path": path,
    "denso_closeup": closeup,
    "denso_errors_feedback": feedback_errors,
    "denso_errors_traditional": traditional_errors,
    "denso_drift": drift,
}
