"""Levenberg-Marquardt never holds the Jacobian: peak memory of a step, measured in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

STEP = """
import json, resource, sys
import torch
from ikgrad.networks import MLP
from ikgrad.optim import LevenbergMarquardt

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # GiB, as Linux counts in KiB

torch.set_num_threads(1)
rows, hidden = map(int, sys.argv[1:])
x = 2.0 * torch.rand(rows, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 1.0
y = torch.stack([x[:, k] * x[:, k + 6] + x[:, k].sin() for k in range(6)], 1)
network = MLP((12, hidden, 6), seeds=0)
optimizer = LevenbergMarquardt(network.parameters())
before, start = peak(), (network(x) - y).square().sum().item()
loss = optimizer.step(lambda: network(x) - y).item()
weights = sum(p.numel() for p in network.parameters())
print(json.dumps({"before": before, "peak": peak(), "weights": weights, "residuals": 6 * rows, "fell": loss < start}))
"""


def measured(rows: int, hidden: int) -> dict[str, float]:
    command = [sys.executable, "-c", STEP, str(rows), str(hidden)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_step_takes_a_fraction_of_the_jacobian():
    got = measured(10_000, 52)
    jacobian = got["residuals"] * got["weights"] * 8 / 2**30
    assert got["fell"]
    assert jacobian > 0.4
    assert got["peak"] - got["before"] < 0.5 * jacobian


@pytest.mark.slow
def test_a_hundred_thousand_residuals_of_five_thousand_weights_fit_in_two_gigabytes():
    """The Jacobian alone would be 4 GB."""
    got = measured(16_667, 263)
    assert got["residuals"] >= 100_000
    assert got["weights"] >= 5_000
    assert got["fell"]
    assert got["peak"] * 2**30 < 2e9
