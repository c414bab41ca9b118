"""Levenberg-Marquardt never holds the Jacobian: peak memory of a step, measured in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts/measure_lm_memory.py"


def measured(size: str) -> dict[str, float]:
    command = [sys.executable, str(SCRIPT), size, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_step_takes_a_fraction_of_the_jacobian():
    got = measured("10000:52")
    assert got["fell"]
    assert got["jacobian"] > 4e8
    assert got["peak"] - got["before"] < 0.5 * got["jacobian"]


@pytest.mark.slow
def test_a_hundred_thousand_residuals_of_five_thousand_weights_fit_in_two_gigabytes():
    """The Jacobian alone would be 4 GB."""
    got = measured("16667:263")
    assert got["residuals"] >= 100_000
    assert got["weights"] >= 5_000
    assert got["fell"]
    assert got["peak"] < 2e9
