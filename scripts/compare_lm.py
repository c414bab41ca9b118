"""Our Levenberg-Marquardt beside the package torch-levenberg-marquardt: same network, data, start and threads.

    pip install '.[bench]'
    python scripts/compare_lm.py [--epochs 68 200] [--seeds 10] [--threads 1]

The feedback network of the Denso study, 12-10-6, tanh and linear, on the 2,800 training rows of its scheme B, all
scaled to [-1, 1]; the package with its own defaults, solver Cholesky. It divides J^T J by the number of rows before it
adds its damping, so that its mu of 1e-3 is one of 2.8 here: with that we have to take the same steps. Ours with our own
defaults, and with a damping that grows by 3 instead of 10 after a failure, stand beside it. Exit status 1 if our median
loss over the seeds, with the same damping or with the growth of 3, is worse than the package's, or if an epoch of ours
is not three times as fast.
"""

from __future__ import annotations

import argparse
import copy
import importlib.metadata
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

import ikgrad as ik
from ikgrad.data import SmoothPath, generate
from ikgrad.networks import MinMax

FASTER, ROUNDING = 3.0, 1e-3
PACKAGE, SAME, STOCK, GENTLE = "package", "ours, same damping", "ours, as it is", "ours, increase=3"


def main() -> int:
    """Train, time, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, nargs="+", default=[68, 200], help="when to look")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    version = importlib.metadata.version("torch-levenberg-marquardt")
    print(f"torch {torch.__version__}, torch-levenberg-marquardt {version}, threads: {args.threads}")
    marks = sorted(args.epochs)
    print(f"{'seed':>6}  {'mean square after':<20}{''.join(f'{mark:>10} epochs' for mark in marks)}{'ms an epoch':>13}")
    table: dict[str, list[Run]] = {}
    for seed in range(args.seeds):
        for name, run in runs(seed, marks):
            table.setdefault(name, []).append(run)
            print(_line(str(seed), name, run), flush=True)
    medians = {name: _median(each) for name, each in table.items()}
    for name, run in medians.items():
        print(_line("median", name, run))
    return _verdict(table, medians)


def _line(seed: str, name: str, run: Run) -> str:
    return f"{seed:>6}  {name:<20}{''.join(f'{loss:>17.4g}' for loss in run.losses)}{run.milliseconds:>13.1f}"


def _median(each: list[Run]) -> Run:
    losses = tuple(map(statistics.median, zip(*(run.losses for run in each), strict=True)))
    return Run(losses, statistics.median(run.milliseconds for run in each))


def _verdict(table: dict[str, list[Run]], medians: dict[str, Run]) -> int:
    ratios = [b.milliseconds / a.milliseconds for a, b in zip(table[SAME], table[PACKAGE], strict=True)]
    pairs = zip(table[SAME], table[PACKAGE], strict=True)
    apart = max(abs(a / b - 1) for ours, theirs in pairs for a, b in zip(ours.losses, theirs.losses, strict=True))
    print(f"an epoch of the package takes {min(ratios):.1f} to {max(ratios):.1f} times ours;", end=" ")
    print(f"with the same damping the mean squares differ by {apart:.1g} at most, relatively")
    bars = [(1 + ROUNDING) * loss for loss in medians[PACKAGE].losses]
    worse = any(a > b for name in (SAME, GENTLE) for a, b in zip(medians[name].losses, bars, strict=True))
    return int(worse or min(ratios) < FASTER)


def runs(seed: int, marks: Sequence[int]) -> Iterator[tuple[str, Run]]:
    """All ways to train from one start."""
    x, y = patterns(seed)
    start = network(seed)
    ways = {
        PACKAGE: their_step,
        SAME: our_step(mu=1e-3 * len(x)),
        STOCK: our_step(),
        GENTLE: our_step(increase=3.0),
    }
    for name, make in ways.items():
        yield name, train(copy.deepcopy(start), x, y, make, marks)


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


def our_step(**settings: float) -> Make:
    """One epoch of ours."""

    def make(net: nn.Module) -> Step:
        optimizer = ik.optim.LevenbergMarquardt(net.parameters(), **settings)
        return lambda x, y: optimizer.step(lambda: net(x) - y)

    return make


def their_step(net: nn.Module) -> Step:
    """One epoch of the package's."""
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    return LevenbergMarquardtModule(net, solve_method="cholesky").training_step


class Run(NamedTuple):
    """What came out of a training: mean squares at the marks, and the median of the milliseconds an epoch."""

    losses: tuple[float, ...]
    milliseconds: float


def train(net: nn.Module, x: Tensor, y: Tensor, make: Make, marks: Sequence[int]) -> Run:
    """Train to the last mark."""
    step = make(net)
    times: list[float] = []
    losses = []
    for epoch in range(1, max(marks) + 1):
        begin = time.perf_counter()
        step(x, y)
        times.append(time.perf_counter() - begin)
        if epoch in marks:
            with torch.no_grad():
                losses.append((net(x) - y).square().mean().item())
    return Run(tuple(losses), 1e3 * statistics.median(times))


if __name__ == "__main__":
    sys.exit(main())
