"""The figures of the study."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ikgrad import plots
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.puma.path import path_data
from ikgrad.papers.puma.study import PumaStudy
from ikgrad.papers.puma.training import Stack, paper_rules
from ikgrad.robot import load_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def learning(study: PumaStudy) -> Figure:
    """Error against epoch of all rules on the printed data, median and range over the seeds."""
    cases = [case for case in study.cases if case.data == "printed"]
    curves = {case.rule.name: (case.curve_epochs.numpy(), case.curve.numpy()) for case in cases}
    literal = study.literal
    curves["eq. (58) as printed"] = (literal.curve_epochs.numpy(), literal.curve.numpy())
    return plots.learning_curves(curves, ylabel="rms error of the scaled outputs [-]")


def with_rate(learning_rate: float, *, seeds: int = 4, epochs: int = 1000) -> Figure:
    """Error against epoch of the three batch rules on the printed data, all with another learning rate."""
    curves = {}
    for rule in paper_rules():
        if rule.order == "batch":
            stack = Stack([replace(rule, lr=learning_rate)], seeds, ["printed"])
            stack.run(epochs)
            (case,) = stack.results()
            curves[rule.name] = (case.curve_epochs.numpy(), case.curve.numpy())
    return plots.learning_curves(curves, ylabel="rms error of the scaled outputs [-]")


def errors(study: PumaStudy) -> Figure:
    """Rms of every seed by rule and data set, with what the paper's tables give."""
    groups = {
        data: {case.rule.name: case.rms_deg.numpy() for case in study.cases if case.data == data}
        for data in ("printed", "corrected")
    }
    printed = {case.name: case.rms_deg for case in study.printed if not case.copy_of}
    return plots.spread(
        groups, ylabel="rms error over nine poses [deg]", reference=printed, reference_label="paper's tables"
    )


def path(study: PumaStudy) -> Figure:
    """The arm on the corrected path, with the path that the median network of the best rule takes."""
    robot = load_robot("puma560")
    data = path_data("corrected")
    cases = [case for case in study.cases if case.data == "corrected"]
    best, worst = (pick(cases, key=lambda case: case.rms_deg.quantile(0.5).item()) for pick in (min, max))
    tracks = {"path of Table 1": data.p.numpy()}
    for case in (best, worst):
        q = data.q + case.errors_deg[case.median_seed].deg2rad()
        tracks[case.rule.name] = forward_kinematics(robot, q)[:, :3, 3].numpy()
    return plots.arm_path(robot, [data.q[0], data.q[4], data.q[8]], paths=tracks, legend="wrist", radius=0.06)


FIGURES = {"puma_learning": learning, "puma_errors": errors, "puma_path": path}
