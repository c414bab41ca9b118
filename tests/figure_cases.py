"""Figures from inputs that are the same everywhere, for tests and for scripts/refresh_images.py."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

import ikgrad as ik
from ikgrad import plots
from ikgrad.collision import Capsules, Spheres
from ikgrad.evaluation import Evaluation, Local, TracIK
from ikgrad.evaluation import Path as SmoothPath
from ikgrad.plots.curves import Curve, Group, curve_panels
from ikgrad.plots.methods import method_errors, method_speed
from ikgrad.plots.places import pose_frames, pose_places
from ikgrad.plots.race import solver_times

LINKS = np.cumsum(np.random.default_rng(0).normal(size=(6, 3, 1, 3)), axis=1).repeat(2, axis=2)
LINKS[:, :, 1] += 1.0
HITS = np.arange(18).reshape(6, 3) % 4 == 0
BALL = dict(centers=np.array([[1.0, 0.0, 0.5]]), radii=np.array([0.4]))
CURVES = {name: 10.0 ** -np.linspace(0, 9, k) for name, k in (("a", 50), ("b", 90), ("c", 20))}


def arm() -> object:
    robot = ik.load_robot("kr210")
    poses = [torch.zeros(6).double(), torch.full((6,), 0.3).double()]
    path = ik.forward_kinematics(robot, torch.stack(poses))[:, :3, 3].numpy()
    return plots.arm_path(robot, poses, paths={"way": path}, points={"end": path[-1]})


T = np.linspace(0.0, 1.0, 40)
WAY = np.stack([np.sin(6 * T), np.cos(6 * T), T], axis=1)
RUNS = 10.0 ** -np.linspace([0, 0.5], [4, 6], 40)  # (E, S)


def motions() -> dict[str, ik.Trajectory]:
    ends = torch.tensor([[-0.8, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8], [0.8, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8]])
    return {"line": ik.via_point_trajectory(ends, [0.0, 1.0], kind="quintic")}


def among_obstacles() -> object:
    ball = Spheres(torch.tensor([[0.5, 0.0, 0.5]]), torch.tensor([0.12]))
    return plots.arm_motion(ik.load_robot("panda"), {**motions(), "again": motions()["line"]}, ball, poses=4)


def with_clearance() -> object:
    ball = Spheres(torch.tensor([[0.5, 0.0, 0.5]]), torch.tensor([0.12]))
    both = {**motions(), "again": motions()["line"]}
    return plots.arm_motion(ik.load_robot("panda"), both, ball, poses=2, margin=0.02)


def among_poles() -> object:
    pole = Capsules(torch.tensor([[[0.5, 0.0, 0.0], [0.5, 0.0, 0.5]]]), torch.tensor([0.06]))
    return plots.arm_motion(ik.load_robot("panda"), motions(), pole, poses=3)


@functools.cache
def evaluated() -> list[Evaluation]:
    inverter = ik.UnrolledInverter(ik.load_robot("panda"), rounds=1, width=8)
    return [ik.evaluate(inverter, protocol(count=50), plain_steps=()) for protocol in (Local, TracIK, SmoothPath)]


def page() -> object:
    return plots.evaluation_page(evaluated(), ik.load_robot("panda"), title="panda")


def solved_batch() -> object:
    rng = np.random.default_rng(1)
    errors = 10.0 ** rng.normal(-8.5, 0.6, (2, 4000))
    reasons = np.where(rng.random(4000) < 0.06, "unreachable", "converged").astype(object)
    reasons[:40] = "joint_limits"
    errors[:, reasons != "converged"] = 10.0 ** rng.normal(-1.5, 0.5, (2, (reasons != "converged").sum()))
    steps = np.where(reasons == "converged", rng.poisson(5, 4000), rng.integers(40, 200, 4000))
    return plots.solve_summary(*errors, steps, reasons.astype(str), title="panda: 4,000 poses")


def workspace() -> object:
    robot = ik.load_robot("panda")
    q = ik.sample_configurations(robot, 4000, seed=0)
    p = ik.forward_kinematics(robot, q)[:, :3, 3].numpy()
    far = np.linalg.norm(p - [0, 0, 0.333], axis=1)
    return plots.workspace_errors(robot, p, 1e-9 * 10.0**far, far < 0.75, title="panda")


def reach(size: float, **options: Any) -> object:
    found = ik.reachability(ik.load_robot("ur5e"), cell=size, orientations=2)
    return plots.workspace_map(found.centres.numpy(), found.share.numpy(), found.condition.numpy(), **options)


def frames() -> object:
    robot = ik.load_robot("panda")
    q = torch.tensor([[0.0, 0.3, 0.0, -1.9, 0.0, 2.2, 0.8], [0.9, 0.6, 0.2, -1.5, 0.0, 2.2, 0.8]]).double()
    return plots.arm_frames(robot, q, targets=ik.forward_kinematics(robot, q), title="panda")


def some_poses() -> np.ndarray:
    robot = ik.load_robot("panda")
    return ik.forward_kinematics(robot, ik.sample_configurations(robot, 600, seed=0)).numpy()


def runs() -> object:
    steps = np.arange(1.0, 400.0, 4.0)
    groups = []
    for name, rate in (("lr 0.01", 1.0), ("lr 0.001", 0.6)):
        curves = [Curve(steps[: 100 - 9 * k], 100.0 * steps[: 100 - 9 * k] ** (-rate - 0.1 * k)) for k in range(3)]
        groups.append(Group(name, {"median": curves, "95 %": [Curve(c.x, 8 * c.y) for c in curves]}))
    return curve_panels(groups, {"position error [mm]": ("median", "95 %")}, xlabel="step", title="two groups of runs")


def records() -> list[dict[str, Any]]:
    def row(method: str, scale: float, microseconds: float) -> dict[str, Any]:
        errors = {"position_mm": [scale, 9 * scale, 80 * scale], "rotation_deg": [0.1 * scale, scale, 30 * scale]}
        return {"method": method, "errors": errors, "microseconds": microseconds}

    rows = [row("inverter", 0.3, 9.0), row("inverter + 1 step", 0.01, 11.0), row("plain, 2 steps", 4.0, 2.0)]
    rows += [row("plain, 4 steps", 0.3, 4.0), row("solve_ik", 1e-6, 20.0)]
    return [
        {"robot": "panda", "protocol": name, "task": f"{name}, 0.5 rad", "count": 1000, "rows": rows[: 5 - k]}
        for k, name in enumerate(("local", "path"))
    ]


def cells() -> list[dict[str, Any]]:
    def cell(robot: str, solver: str, us: float, ratio: float, success: float) -> dict[str, Any]:
        mean = {"value": 1e-6 * us, "low": 0.9e-6 * us, "high": 1.2e-6 * us}
        return dict(
            robot=robot, solver=solver, batch=1000, threads=1, job="ik", mean=mean, missing=None, success=success
        ) | {"ratio": {"value": ratio, "low": ratio, "high": ratio}}

    return [
        cell(robot, *values)
        for robot in ("panda", "ur5e")
        for values in (("ikgrad", 2.0, 1.0, 1.0), ("another", 90.0, 45.0, 0.97), ("a third", 4000.0, 2000.0, 0.6))
    ]


FIGURES: dict[str, Callable[[], Any]] = {
    "workspace_map": lambda: reach(0.1, cell=0.1, title="ur5e"),
    "workspace_map_bare": lambda: reach(0.9),
    "pose_places": lambda: pose_places(some_poses(), title="600 poses"),
    "pose_density": lambda: pose_places(np.concatenate([some_poses()] * 4), title="2,400 poses"),
    "pose_frames": lambda: pose_frames(some_poses(), title="600 poses"),
    "curve_panels": runs,
    "method_errors": lambda: method_errors(records(), title="methods"),
    "method_speed": lambda: method_speed(records(), title="speed"),
    "solver_times": lambda: solver_times(cells(), title="a race"),
    "drift": lambda: plots.traces(
        {f"seed {k}": (0.1 + 0.02 * k * np.arange(300.0) ** (1 + 0.2 * k))[:, None] for k in range(3)},
        panels=["position error [mm]"],
        xlabel="step",
        log=True,
        title="closed loop",
    ),
    "solve_summary": solved_batch,
    "workspace_errors": workspace,
    "arm_frames": frames,
    "evaluation_page": page,
    "convergence": lambda: plots.convergence(CURVES, threshold=1e-9, printed={"a": 50, "b": 80}),
    "one_curve": lambda: plots.convergence({"a": CURVES["a"]}, threshold=1e-9),
    "learning_rates": lambda: plots.learning_rates(
        {0.1: CURVES["a"], 1.0: CURVES["b"]},
        {0.1: np.array([1e-9, 1e-8]), 1.0: np.array([1e-3, 2e-3])},
        threshold=1e-9,
        limit=60,
    ),
    "comparison_bars": lambda: plots.comparison_bars({"a": 3.0, "b": 5.0}, {"a": 3.0, "b": 4.0}, ylabel="count [-]"),
    "arm_path": arm,
    "learning_curves": lambda: plots.learning_curves({"a": (1.0 + np.arange(40), RUNS)}, ylabel="error [-]"),
    "performance": lambda: plots.performance(
        {"training": RUNS, "validation": 2 * RUNS},
        WAY,
        WAY + 0.1,
        ylabel="error [rad$^2$]",
        pair_unit="rad",
        note="R = 0.9",
        mark=(20, 1e-3, "theirs"),
        title="both",
    ),
    "traces": lambda: plots.traces(
        {"a": WAY, "b": 0.9 * WAY},
        panels=["x [m]", "y [m]", "z [m]"],
        x=T,
        xlabel="time [s]",
        limit=2,
        notes=list("ijk"),
    ),
    "closeups": lambda: plots.closeups(
        WAY, {"a": 1.01 * WAY}, x=T, windows=[(0.2, 0.5)] * 3, panels=list("xyz"), xlabel="time [s]", unit="m"
    ),
    "curves_in_space": lambda: plots.curves_in_space(
        {"wanted": WAY, "a": 1.1 * WAY}, points={"i": WAY[3]}, unit="m", title="a path"
    ),
    "swept_arm": lambda: plots.swept_arm(
        LINKS, predicted=LINKS + 0.1, touching=HITS, touching_predicted=~HITS, **BALL, title="sweep"
    ),
    "traces_of_one": lambda: plots.traces({"a": LINKS[:, 0, 0]}, panels=["x [m]", "y [m]", "z [m]"], xlabel="time [s]"),
    "arm_motion": among_obstacles,
    "arm_motion_poles": among_poles,
    "arm_motion_chart": with_clearance,
}
