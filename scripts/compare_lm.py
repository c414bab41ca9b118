"""Our Levenberg-Marquardt beside the package torch-levenberg-marquardt: same network, data, start and threads.

    pip install '.[bench]'
    python scripts/compare_lm.py [--epochs 68] [--seeds 5] [--threads 1]

The feedback network of the Denso study, 12-10-6, tanh and linear, on the 2,800 training rows of its scheme B, all
scaled to [-1, 1]; the package with its own defaults, solver Cholesky. It divides J^T J by the number of rows before it
adds its damping, so that its mu of 1e-3 is one of 2.8 here: with that we have to take the same steps. Ours with our own
first mu, and for as long as the package takes, stand beside it. Exit status 1 if with the same damping our median loss
over the seeds is worse than the package's, or an epoch of ours is not three times as fast.
"""

from __future__ import annotations

import argparse
import copy
import importlib.metadata
import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor, nn

import ikgrad as ik
from ikgrad.data import SmoothPath, generate
from ikgrad.networks import MinMax

FASTER, ROUNDING = 3.0, 1e-3
PACKAGE, SAME = "package", "ours, same damping"


def main() -> int:
    """Train, time, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=68)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    version = importlib.metadata.version("torch-levenberg-marquardt")
    print(f"torch {torch.__version__}, torch-levenberg-marquardt {version}, threads: {args.threads}")
    print(f"{'seed':>6}  {'':<26}{'epochs':>7}{'mean square':>13}{'ms an epoch':>13}")
    table: dict[str, list[Run]] = {}
    for seed in range(args.seeds):
        for name, run in runs(seed, args.epochs):
            table.setdefault(name, []).append(run)
            print(f"{seed:>6}  {name:<26}{run.epochs:>7}{run.loss:>13.4g}{run.milliseconds:>13.1f}", flush=True)
    for name, each in table.items():
        loss, ms, epochs = (
            statistics.median(v) for v in zip(*((r.loss, r.milliseconds, r.epochs) for r in each), strict=True)
        )
        print(f"{'median':>6}  {name:<26}{epochs:>7g}{loss:>13.4g}{ms:>13.1f}")
    ours, theirs = table[SAME], table[PACKAGE]
    ratios = [b.milliseconds / a.milliseconds for a, b in zip(ours, theirs, strict=True)]
    apart = max(abs(a.loss / b.loss - 1) for a, b in zip(ours, theirs, strict=True))
    print(f"an epoch of the package takes {min(ratios):.1f} to {max(ratios):.1f} times ours;", end=" ")
    print(f"with the same damping the mean squares differ by {apart:.1g} at most, relatively")
    worse = statistics.median(run.loss for run in ours) > (1 + ROUNDING) * statistics.median(run.loss for run in theirs)
    return int(worse or min(ratios) < FASTER)


def runs(seed: int, epochs: int) -> Iterator[tuple[str, Run]]:
    """All ways to train from one start, the package first, since its time is what one of ours gets."""
    x, y = patterns(seed)
    start = network(seed)
    same = our_step(mu=1e-3 * len(x))
    theirs = train(copy.deepcopy(start), x, y, their_step, epochs=epochs)
    yield PACKAGE, theirs
    yield SAME, train(copy.deepcopy(start), x, y, same, epochs=epochs)
    yield "ours, mu 1e-3", train(copy.deepcopy(start), x, y, our_step(mu=1e-3), epochs=epochs)
    yield "ours, the package's time", train(copy.deepcopy(start), x, y, same, seconds=theirs.seconds)


def patterns(seed: int) -> tuple[Tensor, Tensor]:
    """Scaled training rows of scheme B."""
    rows = generate(ik.load_robot("denso_vp6242"), SmoothPath(seed=seed)).train
    inverter = ik.Inverter(ik.load_robot("denso_vp6242"), feedback=True).fit(rows.T, rows.q, rows.q_current)
    x = inverter.features(rows.T, rows.q_current)
    scale = [MinMax(data.shape[-1], low=-1.0, high=1.0).fit(data) for data in (x, rows.q)]
    return scale[0](x).detach(), scale[1](rows.q).detach()


def network(seed: int) -> nn.Module:
    """12-10-6, the same for both."""
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(12, 10), nn.Tanh(), nn.Linear(10, 6)).double()


Step = Callable[[Tensor, Tensor], object]
Make = Callable[[nn.Module], Step]


def our_step(*, mu: float) -> Make:
    """One epoch of ours."""

    def make(net: nn.Module) -> Step:
        optimizer = ik.optim.LevenbergMarquardt(net.parameters(), mu=mu)
        return lambda x, y: optimizer.step(lambda: net(x) - y)

    return make


def their_step(net: nn.Module) -> Step:
    """One epoch of the package's."""
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    return LevenbergMarquardtModule(net, solve_method="cholesky").training_step


class Run(NamedTuple):
    """What came out of a training: mean square, epochs, median of the milliseconds an epoch, seconds in all."""

    loss: float
    epochs: int
    milliseconds: float
    seconds: float


def train(
    net: nn.Module, x: Tensor, y: Tensor, make: Make, *, epochs: int = sys.maxsize, seconds: float = math.inf
) -> Run:
    """Train for so many epochs or seconds."""
    step = make(net)
    times: list[float] = []
    while len(times) < epochs and sum(times) < seconds:
        begin = time.perf_counter()
        step(x, y)
        times.append(time.perf_counter() - begin)
    with torch.no_grad():
        loss = (net(x) - y).square().mean().item()
    return Run(loss, len(times), 1e3 * statistics.median(times), sum(times))


if __name__ == "__main__":
    sys.exit(main())
