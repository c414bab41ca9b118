"""How long do neural inverters take? Both families and a classic network, beside plain damped steps.

    python scripts/bench_inverters.py [--robot panda] [--poses 10000] [--threads 2] [--rounds 15]

Weights do not matter for time, so the networks are untrained, of default size. The kinds take turns; the shortest of
all rounds counts. ``whole`` is the same inverter without blocks, as it runs where gradients are wanted.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable

import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.solvers.damped import damped_steps


def main() -> None:
    """Print one line a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    robot = ik.load_robot(options.robot)
    T, q, q_current = TaskStream(robot, batch_size=options.poses).batch(0)
    increment, unrolled = ik.IncrementInverter(robot).eval(), ik.UnrolledInverter(robot).eval()
    classic = ik.Inverter(robot, feedback=True, hidden=(128, 128), dtype=torch.float32)
    classic.fit(T.float(), q.float(), q_current.float())
    single = T.float(), q_current.float()
    cases: dict[str, Callable[[], object]] = {
        f"increment, {_size(increment)}": lambda: increment(T, q_current),
        "increment, whole": lambda: increment.iterates(T, q_current),
        f"unrolled, {unrolled.rounds} rounds of {_size(unrolled)}": lambda: unrolled(T, q_current),
        "unrolled, whole": lambda: unrolled.iterates(T, q_current),
        "classic, 2 x 128": lambda: classic(*single),
        "4 plain damped steps": lambda: damped_steps(robot, T, q_current, steps=4),
    }
    best = dict.fromkeys(cases, float("inf"))
    with torch.no_grad():
        for _ in range(options.rounds):
            for name, run in cases.items():
                begun = time.perf_counter()
                run()
                best[name] = min(best[name], time.perf_counter() - begun)
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} thread(s)")
    print(f"{robot.name}: {options.poses:,} poses, shortest of {options.rounds}")
    for name, seconds in best.items():
        print(f"  {name:32s} {1e3 * seconds:9.2f} ms   {1e6 * seconds / options.poses:8.3f} us a pose")


def _size(inverter: ik.IncrementInverter) -> str:
    return f"{inverter.network.depth} x {inverter.network.width}"


if __name__ == "__main__":
    main()
