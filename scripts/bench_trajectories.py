"""How long do trajectories through via points take, beside scipy's splines?

    python scripts/bench_trajectories.py [--trajectories 1000] [--points 8] [--joints 7] [--times 200] [--rounds 15]

Random points, float64. Every round times every line, so that a busy machine is busy for all; printed are the smallest
of the rounds [ms] and, for scipy, that over ours of the same kind.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import scipy
import torch
from scipy.interpolate import CubicSpline, make_interp_spline

import ikgrad as ik


def main() -> None:
    """Print one line a job."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectories", type=int, default=1000)
    parser.add_argument("--points", type=int, default=8)
    parser.add_argument("--joints", type=int, default=7)
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    jobs, beside = make_jobs(options)
    rounds = {name: [] for name in jobs}
    for _ in range(options.rounds):
        for name, job in jobs.items():
            rounds[name].append(seconds(job))
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads, scipy {scipy.__version__}")
    sizes = f"{options.points} points, {options.joints} joints, {options.times} times"
    print(f"{options.trajectories:,} trajectories, {sizes}\n")
    for name, values in rounds.items():
        line = f"{name:<46} {1e3 * min(values):8.2f} ms"
        if name in beside:
            line += f"   {min(values) / min(rounds[beside[name]]):.2f} of ours"
        print(line)


def make_jobs(options: argparse.Namespace) -> tuple[dict[str, Callable[[], object]], dict[str, str]]:
    """What is timed, by name; and which of ours a line of scipy's stands beside."""
    generator = torch.Generator().manual_seed(0)
    shape = (options.trajectories, options.points, options.joints)
    points = torch.rand(shape, dtype=torch.float64, generator=generator, requires_grad=True)
    breaks = torch.arange(options.points, dtype=torch.float64)
    t = torch.linspace(0, float(breaks[-1]), options.times, dtype=torch.float64)
    own = t.expand(options.trajectories, -1).contiguous()
    fixed = points.detach()
    curves = {kind: ik.via_point_trajectory(fixed, breaks, kind=kind) for kind in ("cubic", "quintic")}
    rows = fixed.transpose(0, 1).flatten(1).numpy()  # scipy: (points, trajectories * joints)
    splines = {
        "cubic": lambda: CubicSpline(breaks.numpy(), rows, bc_type="clamped"),
        "quintic": lambda: make_interp_spline(
            breaks.numpy(), rows, k=5, bc_type=[[(d, 0 * rows[0]) for d in (1, 2)]] * 2
        ),
    }
    made = {kind: spline() for kind, spline in splines.items()}

    def gradient() -> None:
        curve = ik.via_point_trajectory(points, breaks, kind="quintic")
        torch.autograd.grad(curve.position(t).sum(), points)

    jobs: dict[str, Callable[[], object]] = {}
    beside: dict[str, str] = {}
    for kind, curve in curves.items():
        jobs[f"{kind}: build"] = lambda kind=kind: ik.via_point_trajectory(fixed, breaks, kind=kind)
        jobs[f"{kind}: scipy builds"] = splines[kind]
        jobs[f"{kind}: positions at shared times"] = lambda curve=curve: curve.position(t)
        jobs[f"{kind}: scipy, positions at shared times"] = lambda spline=made[kind]: spline(t.numpy())
        beside[f"{kind}: scipy builds"] = f"{kind}: build"
        beside[f"{kind}: scipy, positions at shared times"] = f"{kind}: positions at shared times"
    jobs["quintic: build, positions, gradient to points"] = gradient
    jobs["quintic: scaled_to two limits"] = lambda: curves["quintic"].scaled_to(velocity_max=0.2, acceleration_max=0.1)
    jobs["quintic: positions, times of its own each"] = lambda: curves["quintic"].position(own)
    jobs["quintic: a single trajectory"] = lambda: ik.via_point_trajectory(fixed[0], breaks, kind="quintic")
    return jobs, beside


def seconds(job: Callable[[], object]) -> float:
    """Wall time of one call."""
    begin = time.perf_counter()
    job()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
