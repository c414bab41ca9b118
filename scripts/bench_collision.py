"""Measure `ikgrad.collision`: speed of distances, what the clearance residual is worth, and the motion check.

    python scripts/bench_collision.py speed
    python scripts/bench_collision.py residual [--robot panda] [--poses 1000] [--scenes 5]
    python scripts/bench_collision.py motions  [--robot panda] [--motions 10000] [--scenes 5] [--samples 10000]

``speed`` times 1,000 configurations x 7 links x 100 spheres. ``residual`` draws scenes of three spheres, and poses of
configurations that keep clear of them, and solves the poses with and without the residual. ``motions`` compares
`check_motion` with dense sampling of random trajectories, for three tolerances.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable

import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.collision import MotionCheck, PolynomialMotion, Spheres, check_motion, clearance_residual, link_segments
from ikgrad.collision.distance import plain_distance
from ikgrad.collision.links import plain_link_segments

MARGIN, THICKNESS = 0.02, 0.06  # [m] for an arm that reaches 1 m; longer arms in proportion
TOLERANCES = (1e-2, 1e-3, 1e-4)


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["speed", "residual", "motions"])
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--motions", type=int, default=10_000)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} threads")
    robot = ik.load_robot(options.robot)
    if options.what == "speed":
        speed(robot)
    elif options.what == "residual":
        residual(robot, options.poses, options.scenes)
    else:
        motions(robot, options.motions, options.scenes, options.samples)


def spheres(robot: ik.Robot, seed: int) -> Spheres:
    """Three spheres around the arm."""
    generator, size = torch.Generator().manual_seed(seed), robot.length
    way = torch.randn(3, 3, generator=generator, dtype=torch.float64)
    far = 0.35 + 0.35 * torch.rand(3, 1, generator=generator, dtype=torch.float64)
    centers = way / way.norm(dim=-1, keepdim=True) * far
    centers[:, 2] = centers[:, 2].abs() + 0.15
    radii = 0.1 + 0.1 * torch.rand(3, generator=generator, dtype=torch.float64)
    return Spheres(centers * size, radii * size)


def clearance(robot: ik.Robot, obstacles: Spheres, q: Tensor) -> Tensor:
    """(...) the smallest distance, links as capsules."""
    return obstacles.distance(link_segments(robot, q), THICKNESS * robot.length).amin(dim=(-2, -1))


def milliseconds(run: Callable[[], object], repeats: int) -> str:
    """Smallest and median time of a call."""
    for _ in range(3):
        run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - start))
    return f"{min(times):8.3f} ms (median {sorted(times)[repeats // 2]:.3f})"


def speed(robot: ik.Robot) -> None:
    """Distances and segments, kernels against torch, values and gradients."""
    generator = torch.Generator().manual_seed(0)
    links = torch.randn(1000, 7, 2, 3, generator=generator, dtype=torch.float64)
    centers = torch.randn(100, 3, generator=generator, dtype=torch.float64)
    radii = 0.05 + torch.rand(100, generator=generator, dtype=torch.float64)
    q, zero = ik.sample_configurations(robot, 1000, seed=0), torch.zeros((), dtype=torch.float64)
    moving, q_moving = links.clone().requires_grad_(), q.clone().requires_grad_()
    ball, single = Spheres(centers, radii), (links.float(), centers.float(), radii.float())

    def pull(out: Tensor, x: Tensor) -> Tensor:
        return torch.autograd.grad(out.sum(), x)[0]

    print("1,000 configurations x 7 links x 100 spheres")
    rows: list[tuple[str, Callable[[], object], int]] = [
        ("distances, float64", lambda: ik.sphere_link_distance(links, centers, radii), 100),
        ("distances, float32", lambda: ik.sphere_link_distance(*single), 100),
        ("distances, torch operations", lambda: plain_distance(links, centers, radii, zero), 10),
        ("with gradient to links", lambda: pull(ik.sphere_link_distance(moving, centers, radii), moving), 50),
        ("the same, torch operations", lambda: pull(plain_distance(moving, centers, radii, zero), moving), 5),
        (f"segments of {robot.name}", lambda: link_segments(robot, q), 100),
        ("the same, torch operations", lambda: plain_link_segments(robot, q), 20),
        ("joints to distances", lambda: ball.distance(link_segments(robot, q)), 100),
        ("the same with gradient to joints", lambda: pull(ball.distance(link_segments(robot, q_moving)), q_moving), 50),
    ]
    for name, run, repeats in rows:
        print(f"  {name:34s} {milliseconds(run, repeats)}")


def residual(robot: ik.Robot, poses: int, scenes: int) -> None:
    """Share of poses solved and clear, with and without the residual; every pose has a clear solution."""
    margin = MARGIN * robot.length
    print(f"{robot.name}: {scenes} scenes of 3 spheres, {poses} poses each; share of all in percent")
    print("  scene  solved  clear  margin kept | with the residual: solved  clear  margin kept   ms a pose")
    total = torch.zeros(6, dtype=torch.float64)
    for seed in range(scenes):
        obstacles = spheres(robot, seed)
        q = ik.sample_configurations(robot, 40 * poses, seed=seed)
        T = ik.forward_kinematics(robot, q[clearance(robot, obstacles, q) >= margin][:poses])
        wish = clearance_residual(robot, obstacles, margin=margin, link_radius=THICKNESS * robot.length)
        start = time.perf_counter()
        answers = [ik.solve_ik(robot, T, seed=seed), ik.solve_ik(robot, T, seed=seed, extra_residual=wish)]
        each = 1e3 * (time.perf_counter() - start) / len(T)
        share = []
        for answer in answers:
            gap = clearance(robot, obstacles, answer.q)
            for good in (answer.success, answer.success & (gap > 0), answer.success & (gap >= margin - 1e-8)):
                share.append(100 * good.double().mean())
        total += torch.stack(share)
        print(f"  {seed:5d}  " + "  ".join(f"{x:6.2f}" for x in share) + f"   {each:.3f}")
    print("   mean  " + "  ".join(f"{x:6.2f}" for x in total / scenes))


def wander(robot: ik.Robot, count: int, seed: int) -> ik.Trajectory:
    """(count,) motions of three seconds from rest to rest, through four points that are about half a radian apart."""
    generator = torch.Generator().manual_seed(seed)
    steps = 0.5 * torch.randn(count, 4, robot.dof, generator=generator, dtype=torch.float64)
    steps[:, 0] = ik.sample_configurations(robot, count, seed=seed)
    points = steps.cumsum(1).clamp(robot.q_min, robot.q_max)
    return ik.via_point_trajectory(points, [0.0, 1.0, 2.0, 3.0], kind="4-3-4")


def densely(robot: ik.Robot, obstacles: Spheres, trajectory: ik.Trajectory, samples: int) -> Tensor:
    """(B,) smallest distance over equally spaced samples."""
    t = torch.linspace(0.0, 3.0, samples, dtype=torch.float64)
    chunks = trajectory.coefficients.split(max(1, 50_000 // samples))
    parts = [
        clearance(robot, obstacles, ik.Trajectory(trajectory.times, chunk).position(t)).amin(dim=-1) for chunk in chunks
    ]
    return torch.cat(parts)


def motions(robot: ik.Robot, count: int, scenes: int, samples: int) -> None:
    """Verdicts against dense sampling."""
    print(f"{robot.name}: {scenes} scenes of 3 spheres, {count} motions, {samples} samples each")
    print("  tolerance [mm]   free   touching   neither | missed   false alarms   unseen | looks a motion   check [s]")
    found = [_Found() for _ in TOLERANCES]
    for seed in range(scenes):
        obstacles, trajectory = spheres(robot, seed), wander(robot, count // scenes, seed)
        obstacles = Spheres(obstacles.centers, obstacles.radii / 2)
        touching = densely(robot, obstacles, trajectory, samples) <= 0
        motion = PolynomialMotion(trajectory.times, trajectory.coefficients)
        for each, tol in zip(found, TOLERANCES, strict=True):
            start = time.perf_counter()
            check = check_motion(robot, motion, obstacles, link_radius=THICKNESS * robot.length, tol=tol * robot.length)
            each.add(check, touching, time.perf_counter() - start)
    for each, tol in zip(found, TOLERANCES, strict=True):
        print(f"  {1e3 * tol * robot.length:14.3g} {each}")


class _Found:
    """Counts over all scenes."""

    def __init__(self) -> None:
        self.counts, self.motions, self.looks, self.seconds = torch.zeros(6, dtype=torch.int64), 0, 0, 0.0

    def add(self, check: MotionCheck, touching: Tensor, seconds: float) -> None:
        neither = ~check.free & ~check.touches
        parts = (check.free, check.touches, neither, check.free & touching, ~check.free & ~touching)
        unseen = check.touches & ~touching
        self.counts += torch.stack([part.sum() for part in (*parts, unseen)])
        self.counts[4] -= unseen.sum()  # a contact that was found is no false alarm
        self.motions, self.looks = self.motions + len(touching), self.looks + int(check.samples.sum())
        self.seconds += seconds

    def __str__(self) -> str:
        free, touching, neither, missed, false, unseen = self.counts.tolist()
        return (
            f"{free:8d} {touching:10d} {neither:9d} | {missed:6d} {false:14d} {unseen:8d} | "
            f"{self.looks / self.motions:14.1f} {self.seconds:11.2f}"
        )


if __name__ == "__main__":
    main()
