"""What are good starts worth? Random ones, the solver's table of configurations, neural inverters, on the same poses.

    python scripts/bench_seeds.py [--robot panda] [--poses 10000] [--threads 1] [--inverter FOLDER ...]

The poses are those of random configurations inside the limits. All rows are solved to 1e-6 m and 1e-6 rad, inside the
limits, by `solve_ik`; ``guess`` is the time for the guesses, ``total`` that and the solve: the smallest of seven, the
kinds of start taking turns. An inverter guesses its answer, a feedback inverter that from the middle of the ranges.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable

import torch
from torch import Tensor

import ikgrad as ik

ROUNDS = 7
Case = tuple[str, ik.LevenbergMarquardt, Callable[[Tensor], Tensor] | None]


def main() -> None:
    """Print one line a kind of start."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--inverter", nargs="*", default=[], metavar="FOLDER", help="saved by Inverter.save or train")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    robot = ik.load_robot(options.robot)
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, options.poses, seed=0))
    cases: list[Case] = [
        ("random", ik.LevenbergMarquardt(table=False), None),
        ("table", ik.LevenbergMarquardt(), None),
        *((folder, ik.LevenbergMarquardt(), guesser(robot, folder)) for folder in options.inverter),
    ]
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} thread(s)")
    print(f"{robot.name}: {options.poses} random reachable poses")
    print(f"  {'starts':20s} solved   steps a pose: mean, 99 %   guess [ms]   total [ms]   of random")
    times = measure(robot, T, cases)
    slowest = min(total for _, total in times[0])
    for (name, solver, seeder), turns in zip(cases, times, strict=True):
        answer = ik.solve_ik(robot, T, solver=solver, seeder=seeder)
        steps = answer.steps.double()
        guess, total = (1e3 * min(column) for column in zip(*turns, strict=True))
        count = f"{int(answer.success.sum()):6d}   {steps.mean():12.2f}   {steps.quantile(0.99):10.0f}"
        print(f"  {name[-20:]:20s} {count}   {guess:10.2f}   {total:10.2f}   {total / 1e3 / slowest:9.2f}")


def guesser(robot: ik.Robot, folder: str) -> Callable[[Tensor], Tensor]:
    """The seeder made of a saved inverter."""
    inverter = ik.load_inverter(folder, robot)
    if not inverter.feedback:
        return inverter
    low, high = robot.sampling_range
    middle = ((low + high) / 2).to(inverter.dtype)
    return lambda T: inverter(T.to(inverter.dtype), middle)


def measure(robot: ik.Robot, T: Tensor, cases: list[Case]) -> list[list[tuple[float, float]]]:
    """Seconds for guesses and for all, of every case in every turn."""
    times: list[list[tuple[float, float]]] = [[] for _ in cases]
    for _ in range(ROUNDS + 1):  # the first turn loads what is loaded once
        for (_, solver, seeder), turns in zip(cases, times, strict=True):
            guess = 0.0
            if seeder is not None:
                start = time.perf_counter()
                with torch.no_grad():
                    seeder(T)
                guess = time.perf_counter() - start
            start = time.perf_counter()
            ik.solve_ik(robot, T, solver=solver, seeder=seeder)
            turns.append((guess, time.perf_counter() - start))
    return [turns[1:] for turns in times]


if __name__ == "__main__":
    main()
