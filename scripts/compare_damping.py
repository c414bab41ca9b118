"""What the two factors of Levenberg-Marquardt's damping are worth: four small inverters, medians over seeds.

python scripts/compare_damping.py [--epochs 60] [--seeds 6]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence

import torch
from torch import nn

import ikgrad as ik
from ikgrad.data import DataSet, JointBox, Scheme, SmoothPath, generate
from ikgrad.training.inverters import InverterTraining

HOME = tuple(map(math.radians, (0.0, 90.0, 180.0, 0.0, -90.0, 0.0)))
BENT = (0.0, -1.2, 1.4, -1.0, -1.5, 0.3)
FACTORS = {"stock": (10.0, 10.0), "increase=3": (3.0, 10.0), "increase=2, decrease=5": (2.0, 5.0)}
PROBLEMS: dict[str, tuple[str, bool, int, Callable[[int], Scheme]]] = {
    "Denso, smooth path": ("denso_vp6242", True, 10, lambda seed: SmoothPath(home=HOME, seed=seed)),
    "the same, traditional": ("denso_vp6242", False, 10, lambda seed: SmoothPath(home=HOME, seed=seed)),
    "Denso, box": (
        "denso_vp6242", True, 10,
        lambda seed: JointBox(home=HOME, half_width=math.radians(10), noise=math.radians(2), seed=seed),
    ),
    "UR5e, box": ("ur5e", False, 12, lambda seed: JointBox(home=BENT, half_width=0.4, count=2000, seed=seed)),
}  # fmt: skip


def main() -> int:
    """Train all, print the training errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=6)
    args = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{'mean square [rad^2]':<24}{''.join(f'{name:>24}' for name in FACTORS)}")
    for name, (arm, feedback, hidden, scheme) in PROBLEMS.items():
        robot = ik.load_robot(arm)
        data = [generate(robot, scheme(seed)) for seed in range(args.seeds)]
        nets = [
            [ik.Inverter(robot, feedback=feedback, hidden=(hidden,), seed=seed) for seed in range(args.seeds)]
            for _ in FACTORS
        ]
        errors = [trained(*pair, data, args.epochs) for pair in zip(nets, FACTORS.values(), strict=True)]
        print(f"{name:<24}{''.join(f'{error:>24.2g}' for error in errors)}", flush=True)
    return 0


def trained(
    inverters: Sequence[ik.Inverter], factors: tuple[float, float], data: Sequence[DataSet], epochs: int
) -> float:
    """Median of the training errors."""
    increase, decrease = factors

    def make(parameters: Sequence[nn.Parameter], members: int) -> torch.optim.Optimizer:
        return ik.optim.LevenbergMarquardt(parameters, members=members, increase=increase, decrease=decrease)

    training = InverterTraining(inverters, data, optimizer=make)
    training.run(epochs)
    return training.training.history.train_table()[-1].quantile(0.5).item()


if __name__ == "__main__":
    sys.exit(main())
