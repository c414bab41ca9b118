"""What are good starts worth? Random ones, the solver's table of configurations, neural inverters, on the same poses.

    python scripts/bench_seeds.py [--robot panda] [--poses 10000] [--seeds 0 1 2] [--threads 1] [--inverter panda ...]

The poses are those of random configurations inside the limits, another set for every seed. All rows are solved to
1e-6 m and 1e-6 rad, inside the limits, by `solve_ik`; ``guess`` is the time for the guesses, ``total`` that and the
solve: the smallest of the rounds, the kinds of start taking turns, then the mean over the seeds; ``of random``
likewise, with the smallest and the largest of the seeds. An inverter that looks at the present joints starts from the
middle of the ranges.
"""

from __future__ import annotations

import argparse
import platform
import time

import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.solvers.seeding import Seeder, seeds

Case = tuple[str, ik.LevenbergMarquardt, Seeder | None]


def main() -> None:
    """Print one line a kind of start."""
    options = _options()
    torch.set_num_threads(options.threads)
    robot = ik.load_robot(options.robot)
    cases: list[Case] = [
        ("random", ik.LevenbergMarquardt(table=False), None),
        ("table", ik.LevenbergMarquardt(), None),
        *(
            (f"inverter {name}", ik.LevenbergMarquardt(), ik.load_inverter(name, robot=robot))
            for name in options.inverter
        ),
    ]
    columns = torch.stack([_columns(robot, cases, seed, options) for seed in options.seeds])  # (seeds, cases, 5)
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} thread(s)")
    print(f"{robot.name}: {len(options.seeds)} x {options.poses:,} random reachable poses\n")
    print("| starts | solved | steps a pose: mean | 99 % | guess [ms] | total [ms] | of random |")
    print("|---|---|---|---|---|---|---|")
    share = columns[..., 4] / columns[:, :1, 4]
    for k, (name, _, _) in enumerate(cases):
        solved, mean, most, guess, total = columns[:, k].mean(0).tolist()
        spread = f"{share[:, k].mean():.2f} ({share[:, k].min():.2f} to {share[:, k].max():.2f})"
        print(f"| {name} | {100 * solved:.3f} % | {mean:.2f} | {most:.0f} | {guess:.2f} | {total:.2f} | {spread} |")


def _columns(robot: ik.Robot, cases: list[Case], seed: int, options: argparse.Namespace) -> Tensor:
    """(cases, 5): share solved, mean and 99th percentile of the steps, milliseconds for guesses and for all."""
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, options.poses, seed=seed))
    rows = []
    for case, turns in zip(cases, measure(robot, T, cases, options.rounds), strict=True):
        answer = ik.solve_ik(robot, T, solver=case[1], seeder=case[2])
        steps = answer.steps.double()
        times = [1e3 * min(column) for column in zip(*turns, strict=True)]
        rows.append([float(answer.success.double().mean()), float(steps.mean()), float(steps.quantile(0.99)), *times])
    return torch.tensor(rows, dtype=torch.float64)


def measure(robot: ik.Robot, T: Tensor, cases: list[Case], rounds: int) -> list[list[tuple[float, float]]]:
    """Seconds for guesses and for all, of every case in every turn."""
    times: list[list[tuple[float, float]]] = [[] for _ in cases]
    for _ in range(rounds + 1):  # the first turn loads what is loaded once
        for (_, solver, seeder), turns in zip(cases, times, strict=True):
            guess = 0.0
            if seeder is not None:
                start = time.perf_counter()
                seeds(robot, T, seeder)
                guess = time.perf_counter() - start
            start = time.perf_counter()
            ik.solve_ik(robot, T, solver=solver, seeder=seeder)
            turns.append((guess, time.perf_counter() - start))
    return [turns[1:] for turns in times]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--inverter", nargs="*", default=[], metavar="NAME", help="folder or ready-made name")
    return parser.parse_args()


if __name__ == "__main__":
    main()
