"""The figures of the study."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ikgrad import plots
from ikgrad.papers.trajectory.arm import DESTINATIONS, printed_destinations, trajectories
from ikgrad.papers.trajectory.networks import RULES
from ikgrad.papers.trajectory.obstacle import meets, obstacle
from ikgrad.papers.trajectory.patterns import TEST_INSTANTS
from ikgrad.papers.trajectory.study import TrajectoryStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVERY = 4  # instants of the swept arm
TIME = "time [s]"


def joints(study: TrajectoryStudy) -> Figure:
    """The 4-3-4 curves of both destinations: joints, velocities, accelerations of joint 4."""
    t = torch.linspace(0.0, study.config.tf, 401, dtype=torch.float64)
    curves = trajectories(printed_destinations(), study.config.tf)
    values = torch.stack([curves(t, derivative=order)[..., 3] for order in range(3)], dim=-1).rad2deg()
    lines = dict(zip(DESTINATIONS, values.numpy(), strict=True))
    panels = [f"theta 4 {unit}" for unit in ("[deg]", "[deg/s]", "[deg/s$^2$]")]
    return plots.traces(lines, panels=panels, xlabel=TIME, x=t.numpy())


def errors(study: TrajectoryStudy) -> Figure:
    """Errors of the hand over time for both destinations and both rules, median seed."""
    t = torch.linspace(0.0, study.config.tf, TEST_INSTANTS, dtype=torch.float64)
    lines: dict[str, np.ndarray] = {}
    for rule in RULES:
        result = study.networks[rule]["hand"]
        for k, name in enumerate(DESTINATIONS):
            lines[f"{rule}, {name.replace('_', ' ')}"] = result.errors[result.median_seed, k].numpy()
    panels = [f"error in {axis} [unit]" for axis in "xyz"]
    title = "The hand on the way to both unseen destinations, median seed"
    return plots.traces(lines, panels=panels, xlabel=TIME, x=t.numpy(), title=title)


def path(study: TrajectoryStudy) -> Figure:
    """Coordinates of the hand over time: theoretical and by the paper's network."""
    t = torch.linspace(0.0, study.config.tf, TEST_INSTANTS, dtype=torch.float64)
    result = study.networks["per-pattern"]["hand"]
    both = {"theoretical": result.truth, "network": result.answers[result.median_seed]}
    lines = {name: torch.cat([*values], dim=-1).numpy() for name, values in both.items()}
    panels = [f"{axis}, to {name[-1]} [unit]" for name in DESTINATIONS for axis in "xyz"]
    return plots.traces(lines, panels=panels, xlabel=TIME, x=t.numpy())


def sweep(study: TrajectoryStudy) -> Figure:
    """The arm swept along its path to destination 1 with the obstacle, true and predicted links of the paper's net."""
    links = study.links["per-pattern"]
    true, predicted = links.truth[0, ::EVERY], links.predicted[links.shown, 0, ::EVERY]
    ball = obstacle()
    return plots.swept_arm(
        true.numpy(),
        predicted=predicted.numpy(),
        touching=meets(true).numpy(),
        touching_predicted=meets(predicted).numpy(),
        centers=ball.centers.numpy(),
        radii=ball.radii.numpy(),
        unit="unit",
        title="To destination 1, past the obstacle",
    )


FIGURES = {
    "trajectory_joints": joints,
    "trajectory_errors": errors,
    "trajectory_path": path,
    "trajectory_sweep": sweep,
}
