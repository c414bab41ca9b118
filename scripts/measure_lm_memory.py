"""Peak memory of one Levenberg-Marquardt step: python scripts/measure_lm_memory.py [ROWS:HIDDEN ...] [--json].

A network 12-HIDDEN-6 on ROWS rows, six residuals each; every size in a process of its own, since a process does not
forget its peak. "before" is the peak when network and data are there and the step has not begun.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

SIZES = ("10000:52", "16667:105", "16667:263")
GB = 1e9


def main() -> int:
    """Measure each size in a child, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sizes", nargs="*", default=SIZES, metavar="ROWS:HIDDEN")
    parser.add_argument("--json", action="store_true", help="one line of JSON a size")
    parser.add_argument("--here", action="store_true", help="measure the one size in this process")
    args = parser.parse_args()
    if args.here:
        print(json.dumps(one_step(*map(int, args.sizes[0].split(":")))))
        return 0
    if not args.json:
        print(f"{'residuals':>9} {'weights':>8} {'J alone [GB]':>13} {'before [GB]':>12}", end=" ")
        print(f"{'peak [GB]':>10} {'time [s]':>9}")
    for size in args.sizes:
        command = [sys.executable, __file__, size, "--here"]
        line = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        if args.json:
            print(line, end="", flush=True)
            continue
        got = json.loads(line)
        print(f"{got['residuals']:>9} {got['weights']:>8} {got['jacobian'] / GB:>13.2f}", end=" ")
        print(f"{got['before'] / GB:>12.2f} {got['peak'] / GB:>10.2f} {got['seconds']:>9.1f}", flush=True)
    return 0


def one_step(rows: int, hidden: int) -> dict[str, float]:
    """Bytes, counts, seconds, and whether the loss fell."""
    import torch

    from ikgrad.networks import MLP
    from ikgrad.optim import LevenbergMarquardt

    torch.set_num_threads(1)
    x = 2.0 * torch.rand(rows, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 1.0
    y = torch.stack([x[:, k] * x[:, k + 6] + x[:, k].sin() for k in range(6)], 1)
    network = MLP((12, hidden, 6), seeds=0)
    optimizer = LevenbergMarquardt(network.parameters())
    with torch.no_grad():
        first = (network(x) - y).square().sum().item()
    before, begin = peak(), time.perf_counter()
    loss = optimizer.step(lambda: network(x) - y).item()
    weights = sum(p.numel() for p in network.parameters())
    return {
        "residuals": y.numel(),
        "weights": weights,
        "jacobian": 8 * y.numel() * weights,
        "before": before,
        "peak": peak(),
        "seconds": time.perf_counter() - begin,
        "fell": loss < first,
    }


def peak() -> int:
    """Largest resident size of this process so far, in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


if __name__ == "__main__":
    sys.exit(main())
