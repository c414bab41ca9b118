"""Measure `ik.optimize_trajectory`: 1,000 pairs of random ends among three spheres, solved as one batch.

    python scripts/bench_planning.py [--robot panda] [--pairs 1000] [--seeds 10 11 12] [--roadmap] [--pictures FOLDER]

For each seed a scene, and ends that keep the margin. Everything in the table is measured anew on the trajectories that
came out: free by `check_motion`, inside the joint limits by the exact extremes, and within the limits on speed and
acceleration by the exact peaks. Beside it the straight line, and random detours without any descent for as long
as ours took. ``--roadmap`` asks for each pair that failed if a roadmap of random configurations that keep
the margin connects its ends. ``--pictures`` draws one motion before and after.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from bench_collision import MARGIN, THICKNESS, clearance, spheres
from torch import Tensor

import ikgrad as ik
from ikgrad import plots
from ikgrad.collision import PolynomialMotion, Spheres, check_motion

TOLERANCE = 1e-5  # of the check [m]
SPEED, PUSH = 2.0, 8.0  # limits of all joints [rad/s], [rad/s^2]


class Scene(NamedTuple):
    """One batch."""

    robot: ik.Robot
    obstacles: Spheres
    start: Tensor  # (B, n)
    goal: Tensor

    @property
    def margin(self) -> float:
        """What links must keep [m]."""
        return MARGIN * self.robot.length

    @property
    def thick(self) -> float:
        """Radius of the links [m]."""
        return THICKNESS * self.robot.length


class Verdict(NamedTuple):
    """What is measured on trajectories, all (B,)."""

    free: Tensor  # touches nothing, proven
    kept: Tensor  # margin kept, proven
    inside: Tensor  # joint, speed and acceleration limits
    clearance: Tensor  # at 1,000 samples [m]
    way: Tensor  # length of the way in joint space [rad]
    duration: Tensor  # [s]
    jerk: Tensor  # largest jerk of all joints [rad/s^3]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[10, 11, 12])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--roadmap", action="store_true")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    robot = ik.load_robot(options.robot)
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} threads")
    thick, margin = 1e3 * THICKNESS * robot.length, 1e3 * MARGIN * robot.length
    print(f"{robot.name}: {options.pairs} pairs a seed, 8 free vias, {SPEED:g} rad/s, {PUSH:g} rad/s^2")
    print(f"3 spheres, links of radius {thick:.0f} mm, margin {margin:.0f} mm")
    optimise(make_scene(robot, 99, 20))  # compiles and warms up
    for seed in options.seeds:
        report(make_scene(robot, seed, options.pairs), seed, options)
    if options.pictures:
        draw(options.pictures)


def make_scene(robot: ik.Robot, seed: int, count: int) -> Scene:
    """Three spheres, and ends that keep the margin."""
    obstacles = spheres(robot, seed)
    q = ik.sample_configurations(robot, 40 * count, seed=seed)
    q = q[clearance(robot, obstacles, q) >= MARGIN * robot.length]
    return Scene(robot, obstacles, q[:count], q[count : 2 * count])


def optimise(scene: Scene) -> ik.OptimizedTrajectory:
    """The call that is measured."""
    return ik.optimize_trajectory(
        scene.robot,
        scene.start,
        scene.goal,
        scene.obstacles,
        margin=scene.margin,
        link_radius=scene.thick,
        velocity_max=SPEED,
        acceleration_max=PUSH,
    )


def report(scene: Scene, seed: int, options: argparse.Namespace) -> None:
    """One seed's rows."""
    begin = time.perf_counter()
    found = optimise(scene)
    spent = time.perf_counter() - begin
    line = straight(scene)
    before, after = judge(scene, line), judge(scene, found.trajectory)
    tries, by_chance = detours_by_chance(scene, seed, spent)
    solved = after.kept & after.inside
    each, steps, agreed = 1e3 * spent / len(solved), found.steps.double().mean(), found.success == solved
    print(f"\nseed {seed}: {spent:.2f} s, {each:.2f} ms and {steps:.1f} steps a pair")
    print(f"  success measured {int(solved.sum())}, as the result says in {int(agreed.sum())} of {len(solved)} rows")
    groups = {"all": torch.ones_like(solved), "straight line breaks margin": ~before.kept, "touches": ~before.free}
    print(f"  margin and limits kept [%]    pairs  straight line  {tries:2d} random detours   ours   touching nothing")
    for name, rows in groups.items():
        kept = (before.kept & before.inside, by_chance.isfinite(), solved, after.free & after.inside)
        share = [100 * x[rows].double().mean().item() for x in kept]
        print(f"  {name:28s} {int(rows.sum()):6d} {share[0]:14.1f} {share[1]:18.1f} {share[2]:6.1f} {share[3]:18.1f}")
    print("  pairs solved whose straight line touches (medians)")
    rows = ~before.free & solved
    for name, v in (("before", before), ("after", after)):
        gap, way, duration, jerk = (x[rows].median().item() for x in (v.clearance, v.way, v.duration, v.jerk))
        least = 1e3 * v.clearance[rows].min().item()
        print(
            f"    {name:6s} clearance {1e3 * gap:6.1f} mm (least {least:6.1f}), way {way:.2f} rad, "
            f"{duration:.2f} s, largest jerk {jerk:.1f} rad/s^3"
        )
    both = rows & by_chance.isfinite()
    times = [x[both].median().item() for x in (before.duration, by_chance, after.duration)]
    told = f"{times[0]:.2f} s before, {times[1]:.2f} s by them, {times[2]:.2f} s by ours"
    print(f"    where random detours succeed too: {told}")
    if options.roadmap:
        failed = torch.nonzero(~solved).flatten()
        joined = torch.zeros_like(solved)
        joined[failed] = roadmap(scene, failed)
        print(f"  failed: {len(failed)}, of which a roadmap connects {int(joined.sum())}")
        known = (solved | joined) & ~before.free
        share = 100 * solved[known].double().mean()
        print(f"    known to have a way though the straight line touches: {int(known.sum())}, ours {share:.1f} %")


def straight(scene: Scene) -> ik.Trajectory:
    """The straight motions with the least jerk, as fast as the limits allow."""
    ends = torch.stack([scene.start, scene.goal], dim=1)
    line = ik.via_point_trajectory(ends, torch.tensor([0.0, 1.0]).double().expand(len(ends), 2), kind="quintic")
    return line.scaled(line.stretch_to(velocity_max=SPEED, acceleration_max=PUSH))


def judge(scene: Scene, path: ik.Trajectory) -> Verdict:
    """Everything measured, nothing believed."""
    robot, motion = scene.robot, PolynomialMotion(path.times, path.coefficients)
    free, kept = (
        check_motion(robot, motion, scene.obstacles, link_radius=thick, tol=TOLERANCE).free
        for thick in (scene.thick, scene.thick + scene.margin)
    )
    low, high = path.extremes()
    inside = ((low >= robot.q_min - 1e-9) & (high <= robot.q_max + 1e-9)).all(dim=-1)
    for order, limit in ((1, SPEED), (2, PUSH)):
        inside &= (path.peak(derivative=order) <= limit * (1 + 1e-9)).all(dim=-1)
    t = path.duration[:, None] * torch.linspace(0, 1, 1000, dtype=torch.float64)
    q = path.position(t)
    gap = torch.cat([clearance(robot, scene.obstacles, part).amin(dim=1) for part in q.split(100)])
    way = q.diff(dim=1).norm(dim=-1).sum(dim=1)
    return Verdict(free, kept, inside, gap, way, path.duration, path.peak(derivative=3).amax(dim=-1))


def detours_by_chance(scene: Scene, seed: int, seconds: float) -> tuple[int, Tensor]:
    """How many random detours a pair fit into the time, and (B,) the duration of the first that is good, or inf."""
    begin, tries = time.perf_counter(), 0
    duration = torch.full((len(scene.start),), torch.inf, dtype=torch.float64)
    u = torch.linspace(0, 1, 10, dtype=torch.float64)
    s = (u**3 * (10 - 15 * u + 6 * u**2))[:, None]
    thick = scene.thick + scene.margin
    while time.perf_counter() - begin < seconds and not bool(duration.isfinite().all()):
        rows = torch.nonzero(duration.isinf()).flatten()
        a, b = scene.start[rows, None], scene.goal[rows, None]
        over = ik.sample_configurations(scene.robot, len(rows), seed=1000 * seed + tries)[:, None] - (a + b) / 2
        size = 0.0 if tries == 0 else (0.3, 0.6, 1.0)[tries % 3]
        path = ik.via_point_trajectory(a + s * (b - a) + size * 4 * s * (1 - s) * over, u, kind="quintic")
        low, high = path.extremes()
        inside = ((low >= scene.robot.q_min) & (high <= scene.robot.q_max)).all(dim=-1)
        motion = PolynomialMotion(path.times, path.coefficients)
        good = inside & check_motion(scene.robot, motion, scene.obstacles, link_radius=thick, tol=TOLERANCE).free
        duration[rows[good]] = path.stretch_to(velocity_max=SPEED, acceleration_max=PUSH)[good]
        tries += 1
    return tries, duration


def roadmap(scene: Scene, rows: Tensor, nodes: int = 30_000, neighbours: int = 24) -> Tensor:
    """Which pairs lie in one component of a graph of random configurations, edges checked at 18 samples."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    robot = scene.robot
    q = ik.sample_configurations(robot, 3 * nodes, seed=9)
    q = q[clearance(robot, scene.obstacles, q) >= scene.margin][:nodes]
    q = torch.cat([scene.start[rows], scene.goal[rows], q])
    scaled = (q * torch.linspace(1.0, 0.2, robot.dof)).numpy()  # the first joints move the most of the arm
    near = cKDTree(scaled).query(scaled, k=neighbours + 1)[1][:, 1:]
    i, j = np.repeat(np.arange(len(q)), neighbours), near.reshape(-1)
    u = torch.linspace(0, 1, 20, dtype=torch.float64)[1:-1, None]
    clear = []
    for part in np.array_split(np.arange(len(i)), 40):
        between = q[i[part], None] + u * (q[j[part]] - q[i[part]])[:, None]
        clear.append((clearance(robot, scene.obstacles, between).amin(dim=1) >= scene.margin).numpy())
    good = np.concatenate(clear)
    graph = coo_matrix((good[good], (i[good], j[good])), shape=(len(q), len(q)))
    label = connected_components(graph, directed=False)[1]
    return torch.from_numpy(label[: len(rows)] == label[len(rows) : 2 * len(rows)])


def draw(folder: Path) -> None:
    """One motion of `panda` between three spheres, before and after."""
    robot = ik.load_robot("panda")
    obstacles = Spheres(
        torch.tensor([[0.55, 0.0, 0.5], [0.15, 0.55, 0.35], [0.3, -0.12, 0.9]]), torch.tensor([0.12, 0.1, 0.1])
    )
    a, b = (torch.tensor([turn, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8], dtype=torch.float64) for turn in (-0.8, 0.8))
    found = optimise(Scene(robot, obstacles, a, b)).raise_if_failed()
    line = ik.via_point_trajectory(torch.stack([a, b]), [0.0, 1.0], kind="quintic")
    line = line.scaled(line.stretch_to(velocity_max=SPEED, acceleration_max=PUSH))
    motions = {"before: straight line": line, "after: optimised": found.trajectory}
    thick, margin = THICKNESS * robot.length, MARGIN * robot.length
    figure = plots.arm_motion(robot, motions, obstacles, link_radius=thick, poses=5, view=(25, -35), margin=margin)
    print("\n" + str(plots.save_figure(figure, folder / "planning_panda.png", dpi=100)))


if __name__ == "__main__":
    main()
