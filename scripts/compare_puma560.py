"""The closed form of the PUMA 560 beside EAIK's, an independent implementation (pip install EAIK).

    python scripts/compare_puma560.py [--poses 100000] [--rounds 7]

Both solve the same random reachable poses, all branches, in turns. The answers are compared on 1,000 poses: every
branch of one must be among those of the other, modulo whole turns. Exit status 1 if they are not.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch

import ikgrad as ik
from ikgrad.bench.environment import environment
from ikgrad.bench.peers.chain import z_chain, zero_axes

AGREE = 1e-6  # rad: near a fold of the arm the last digits of an angle are lost to half
COMPARED = 1000


def main() -> int:
    """Compare answers, then times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=7)
    args = parser.parse_args()

    robot = ik.load_robot("puma560")
    q = ik.sample_configurations(robot, args.poses, seed=0)
    T = ik.forward_kinematics(robot, q)
    eaik, turned = eaik_solver(robot, T)

    worst, counts = disagreement(ik.puma560_ik(T[:COMPARED], limits=False).q.numpy(), eaik(turned[:COMPARED], 1))
    print(f"answers on {COMPARED} poses: EAIK has {counts}, largest distance between the sets {worst:.1e} rad")
    print(environment(["EAIK"]))
    print(f"{'threads':>8} {'ikgrad [us]':>12} {'EAIK [us]':>12} {'EAIK / ikgrad':>22}")
    for threads in (1, 2):
        torch.set_num_threads(threads)
        ours, theirs = race(lambda: ik.puma560_ik(T), lambda n=threads: eaik(turned, n), args.rounds)
        ratios = [b / a for a, b in zip(ours, theirs, strict=True)]
        spread = f"{statistics.median(ratios):.1f} [{min(ratios):.1f}-{max(ratios):.1f}]"
        times = (1e6 * statistics.median(each) / args.poses for each in (ours, theirs))
        print(f"{threads:>8} {next(times):>12.2f} {next(times):>12.2f} {spread:>22}")
    return 0 if worst < AGREE else 1


def eaik_solver(robot: ik.Robot, T: torch.Tensor) -> tuple[Callable[..., list], np.ndarray]:
    """EAIK's batched call, and the targets turned to its tip, which has no rotation of its own."""
    from eaik.IK_HP import HPRobot

    axes, steps, rest = zero_axes(z_chain(robot))
    turn = np.eye(4)
    turn[:3, :3] = rest.T
    return HPRobot(axes, steps).IK_batched, T.numpy() @ turn


def race(ours: Callable[[], object], theirs: Callable[[], object], rounds: int) -> tuple[list[float], list[float]]:
    """Seconds of each, in turns, after one call that does not count."""
    times: tuple[list[float], list[float]] = ([], [])
    for k in range(rounds + 1):
        for call, kept in zip((ours, theirs), times, strict=True):
            begin = time.perf_counter()
            call()
            if k:
                kept.append(time.perf_counter() - begin)
    return times


def disagreement(ours: np.ndarray, theirs: list) -> tuple[float, dict[int, int]]:
    """Largest distance of any answer of one to the nearest of the other [rad], and how many answers EAIK has."""
    worst, counts = 0.0, {}
    for mine, answer in zip(ours, theirs, strict=True):
        other = np.asarray(answer.Q, dtype=np.float64).reshape(-1, 6)
        counts[len(other)] = counts.get(len(other), 0) + 1
        turns = mine[:, None] - other[None]
        distance = np.abs((turns + np.pi) % (2 * np.pi) - np.pi).max(-1)
        worst = max(worst, distance.min(0).max(), distance.min(1).max())
    return worst, counts


if __name__ == "__main__":
    sys.exit(main())
