"""Time a step of the classical rules on stacked small networks: torch against the compiled kernels.

    python scripts/bench_training.py [--members 8 16 64] [--threads 1]

Two networks of logistic units: 3-10-6 with nine patterns, one a step and all a step, and 5-30-3 with 2,460 patterns,
one a step. Every time is the smallest of three runs of `Training.run`, with nothing recorded on the way.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Literal

import torch

from ikgrad import optim
from ikgrad.networks import MLP
from ikgrad.training import Batches, Training

Rule = Callable[..., torch.optim.Optimizer]
RULES: dict[str, Rule] = {
    "Backprop": lambda p: optim.Backprop(p, 0.05, momentum=0.5),
    "DeltaBarDelta": lambda p: optim.DeltaBarDelta(p, 0.05, kappa=1e-4, momentum=0.5),
    "Quickprop": lambda p: optim.Quickprop(p, 0.01),
}
PROBLEMS = [((3, 10, 6), 9, 1, None), ((3, 10, 6), 9, 1, 0), ((3, 10, 6), 9, 9, None), ((5, 30, 3), 2460, 1, None)]


def main() -> None:
    """Print one line for every problem, rule and number of networks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[8, 16, 64])
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    print(f"torch {torch.__version__}, {arguments.threads} thread(s); times are us a step of all networks")
    print("| network | patterns | order | rule | networks | torch | compiled | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for sizes, count, batch_size, shuffle in PROBLEMS:
        for name, rule in RULES.items():
            for members in arguments.members:
                work = sizes, count, batch_size, shuffle, rule, members
                slow, fast = microseconds(*work, engine="torch"), microseconds(*work, engine="auto")
                size, order = "-".join(map(str, sizes)), "fixed" if shuffle is None else "random"
                line = f"| {size} | {batch_size} of {count} | {order} | {name} | {members} "
                print(f"{line}| {slow:.0f} | {fast:.2f} | {slow / fast:.0f} |", flush=True)


def microseconds(
    sizes: tuple[int, ...],
    count: int,
    batch_size: int,
    shuffle: int | None,
    rule: Rule,
    members: int,
    *,
    engine: Literal["auto", "torch"],
) -> float:
    """Microseconds of one step of all networks."""
    generator = torch.Generator().manual_seed(0)
    x, y = (0.1 + 0.8 * torch.rand(count, n, dtype=torch.float64, generator=generator) for n in (sizes[0], sizes[-1]))
    net = MLP(sizes, hidden="logistic", output="logistic", members=members, seeds=range(members), bound=0.5)
    orders = None if shuffle is None else [*range(members)]
    if orders is not None:
        x, y = x.repeat(members, 1, 1), y.repeat(members, 1, 1)
    data = Batches(x, y, batch_size=batch_size, shuffle=orders)
    training = Training(net, rule(net.parameters()), data, engine=engine)
    steps = 500 if engine == "torch" else max(2000, 400_000 // members)
    epochs = max(1, steps // data.steps)
    best = float("inf")
    for _ in range(3):
        begin = time.perf_counter()
        training.run(training.epoch + epochs, record=[])
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / epochs / data.steps


if __name__ == "__main__":
    main()
