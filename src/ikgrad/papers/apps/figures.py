"""The figures of the study."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ikgrad import plots
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.apps.compare import descent_curves
from ikgrad.papers.apps.study import AppsStudy
from ikgrad.robot import load_robot
from ikgrad.solvers.apps import Apps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

E0 = 1e-9
LIMIT = 1000  # the paper's I0
POINTS = ("$P_1$", "$P_2$", "$P_3$", "$P_4$", "$P_5$", "$P_6$", "$P_I$")


def convergence(study: AppsStudy) -> Figure:
    """E against iteration for the seven motions, with the paper's counts."""
    printed = {row.motion: row.printed_iterations for row in study.tables.table6}
    return plots.convergence({m.name: m.errors.numpy() for m in study.motions}, threshold=E0, printed=printed)


def path(study: AppsStudy) -> Figure:
    """The arm at its start and at P_3 and P_4, the tool's way during the descent, and the goals."""
    robot = load_robot("kr210")
    tracks = {f"{m.name}": forward_kinematics(robot, m.path)[:, :3, 3].numpy() for m in study.motions}
    goals = {name: m.T_target[:3, 3].numpy() for name, m in zip(POINTS, study.motions, strict=True)}
    poses = [study.motions[0].q_start, *(study.motions[k].q for k in (2, 3))]
    return plots.arm_path(robot, poses, paths=tracks, points=goals)


def learning_rate(study: AppsStudy, motion: str = "I-1") -> Figure:
    """Curves of one motion, and what is left of E after the paper's 1000 iterations, by learning rate."""
    curves: dict[float, np.ndarray] = {}
    finals: dict[float, list[float]] = {}
    for row, curve in zip(study.learning_rates, study.rate_curves, strict=True):
        finals.setdefault(row.eta, []).append(float(curve[:LIMIT][-1]))
        if row.motion == motion:
            curves[row.eta] = curve.numpy()
    left = {rate: np.array(values) for rate, values in finals.items()}
    return plots.learning_rates(curves, left, threshold=E0, limit=LIMIT, title=f"motion {motion}")


def descent(study: AppsStudy, learning_rate: float, motion: str = "I-1") -> Figure:
    """E along one motion with any learning rate, for the paper's 1000 iterations."""
    chosen = [each for each in study.motions if each.name == motion]
    ((_, curve),) = descent_curves(chosen, replace(Apps.reproduces(), max_steps=LIMIT), [learning_rate])
    return plots.convergence({motion: curve.numpy()}, threshold=E0)


def iterations(study: AppsStudy) -> Figure:
    """Iterations of the seven motions beside the paper's."""
    ours = {row.motion: float(row.iterations or 0) for row in study.tables.table6}
    theirs = {row.motion: float(row.printed_iterations) for row in study.tables.table6}
    return plots.comparison_bars(ours, theirs, ylabel="iterations [-]")


FIGURES = {
    "apps_convergence": convergence,
    "apps_path": path,
    "apps_learning_rate": learning_rate,
    "apps_iterations": iterations,
}
