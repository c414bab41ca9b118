"""Our Levenberg-Marquardt beside the package torch-levenberg-marquardt: same network, data, start and threads.

    pip install torch-levenberg-marquardt
    python scripts/compare_lm.py [--epochs 68] [--seeds 3] [--threads 1]

The feedback network of the Denso study, 12-10-6, tanh and linear, on the 2,800 training rows of its scheme B, all
scaled to [-1, 1]; the package with its own defaults, solver Cholesky. Exit status 1 if our median loss over the seeds
is worse than the package's, or an epoch of ours is not three times as fast.
"""

from __future__ import annotations

import argparse
import copy
import importlib.metadata
import statistics
import sys
import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

import ikgrad as ik
from ikgrad.data import SmoothPath, generate
from ikgrad.networks import MinMax

FASTER = 3.0


def main() -> int:
    """Train, time, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=68)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    version = importlib.metadata.version("torch-levenberg-marquardt")
    print(
        f"torch {torch.__version__}, torch-levenberg-marquardt {version}, {args.threads} threads, {args.epochs} epochs"
    )
    print(f"{'seed':>4} {'':>10} {'mean square':>12} {'ms an epoch':>12}")
    losses: dict[str, list[float]] = {"ours": [], "package": []}
    ratios = []
    for seed in range(args.seeds):
        x, y = patterns(seed)
        start, times = network(seed), []
        for name, make in (("ours", our_step), ("package", their_step)):
            loss, milliseconds = run(copy.deepcopy(start), x, y, args.epochs, make)
            losses[name].append(loss)
            times.append(milliseconds)
            print(f"{seed:>4} {name:>10} {loss:>12.4g} {milliseconds:>12.1f}")
        ratios.append(times[1] / times[0])
    ours, theirs = (statistics.median(losses[name]) for name in losses)
    print(
        f"median loss: ours {ours:.4g}, package {theirs:.4g}; an epoch of the package takes {min(ratios):.1f} to",
        end=" ",
    )
    print(f"{max(ratios):.1f} times ours")
    return 0 if ours <= theirs and min(ratios) >= FASTER else 1


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


def our_step(net: nn.Module) -> Step:
    """One epoch of ours."""
    optimizer = ik.optim.LevenbergMarquardt(net.parameters())
    return lambda x, y: optimizer.step(lambda: net(x) - y)


def their_step(net: nn.Module) -> Step:
    """One epoch of the package's."""
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    return LevenbergMarquardtModule(net, solve_method="cholesky").training_step


def run(net: nn.Module, x: Tensor, y: Tensor, epochs: int, make: Callable[[nn.Module], Step]) -> tuple[float, float]:
    """Final mean square and median milliseconds an epoch."""
    step = make(net)
    times = []
    for _ in range(epochs):
        begin = time.perf_counter()
        step(x, y)
        times.append(time.perf_counter() - begin)
    with torch.no_grad():
        return (net(x) - y).square().mean().item(), 1e3 * statistics.median(times)


if __name__ == "__main__":
    sys.exit(main())
