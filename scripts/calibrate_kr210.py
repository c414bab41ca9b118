"""Calibrate a KUKA KR 210 by gradient descent *through* inverse kinematics.

    python scripts/calibrate_kr210.py [--seed 0]

A real arm differs from its data sheet: here each of its six joint origins and the tool are off by up to 0.5 mm and
0.05 deg in every direction. A tracker measures the tool at 60 configurations whose joint angles the encoders give. The
link parameters are found for which inverse kinematics of the measured poses returns the measured joints:

    minimise  sum_i |ik(theta, T_i) - q_i|^2  over theta (7 x 6 numbers), by L-BFGS

The gradient with respect to theta comes from `ikgrad.solve_ik` itself. Judged on 200 configurations never measured.
"""

from __future__ import annotations

import argparse
import math
import time

import torch
from torch import Tensor

import ikgrad as ik

LENGTH, ANGLE = 0.5e-3, math.radians(0.05)  # size of the errors in the link parameters [m], [rad]


def small_motion(xi: Tensor) -> Tensor:
    """(..., 6) -> (..., 4, 4): translation by the first three numbers, rotation vector from the last three."""
    p, w = xi[..., :3], xi[..., 3:]
    x, y, z = w.unbind(-1)
    o = torch.zeros_like(x)
    R = torch.linalg.matrix_exp(torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3)))
    bottom = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=xi.dtype).expand(*xi.shape[:-1], 1, 4)
    return torch.cat([torch.cat([R, p[..., None]], -1), bottom], -2)


def with_parameters(nominal: ik.Robot, theta: Tensor) -> ik.Robot:
    """The robot with its joint origins and tool moved by theta (7, 6), in units of `LENGTH` and `ANGLE`."""
    scale = torch.tensor([LENGTH] * 3 + [ANGLE] * 3, dtype=theta.dtype)
    moved, now = small_motion(theta * scale), nominal.tables()
    return nominal.with_geometry(origins=now.origins @ moved[:-1], tool=now.tool @ moved[-1])


def tool_error(robot: ik.Robot, real: ik.Robot, q: Tensor) -> tuple[float, float]:
    """Mean distance [mm] and angle [deg] between what the model says and where the arm really is."""
    e = ik.pose_error(ik.forward_kinematics(robot, q), ik.forward_kinematics(real, q)).detach()
    return 1e3 * float(e[:, :3].norm(dim=-1).mean()), math.degrees(float(e[:, 3:].norm(dim=-1).mean()))


def calibrate(nominal: ik.Robot, T: Tensor, q: Tensor, *, iterations: int = 200) -> tuple[ik.Robot, list[float]]:
    """Link parameters for which inverse kinematics of the poses T gives the joints q; and the loss on the way."""
    losses: list[float] = []
    theta = torch.zeros(nominal.dof + 1, 6, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS(
        [theta],
        max_iter=iterations,
        history_size=50,
        tolerance_grad=1e-12,
        tolerance_change=0,
        line_search_fn="strong_wolfe",
    )

    def loss() -> Tensor:
        optimizer.zero_grad()
        robot = with_parameters(nominal, theta)
        solution = ik.solve_ik(robot, T, q0=q, limits=False, tol_pos=1e-11, tol_rot=1e-11)
        value = ((solution.q - q) / ANGLE).square()[solution.success].mean()
        value.backward()
        losses.append(float(value.detach()))
        return value

    optimizer.step(loss)
    return with_parameters(nominal, theta.detach()), losses


def simulate(seed: int) -> tuple[ik.Robot, ik.Robot, Tensor, Tensor]:
    """The arm of the data sheet, a real one, 60 configurations to measure at, and 200 to judge at."""
    nominal = ik.load_robot("kr210")
    generator = torch.Generator().manual_seed(seed)
    truth = 2 * torch.rand(nominal.dof + 1, 6, dtype=torch.float64, generator=generator) - 1
    q, unseen = (ik.sample_configurations(nominal, n, seed=s) for n, s in ((60, seed), (200, seed + 1)))
    return nominal, with_parameters(nominal, truth), q, unseen


def main() -> None:
    """Simulate, calibrate, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--iterations", type=int, default=200, help="of L-BFGS (default 200)")
    args = parser.parse_args()
    nominal, real, q, unseen = simulate(args.seed)
    begin = time.perf_counter()
    found, losses = calibrate(nominal, ik.forward_kinematics(real, q), q, iterations=args.iterations)
    seconds = time.perf_counter() - begin
    before, after = tool_error(nominal, real, unseen), tool_error(found, real, unseen)
    print(f"before: {before[0]:.4f} mm {before[1]:.5f} deg on {len(unseen)} unseen configurations")
    print(f"after:  {after[0]:.2e} mm {after[1]:.2e} deg")
    print(f"ratio:  {after[0] / before[0]:.2e} {after[1] / before[1]:.2e}, {len(losses)} evaluations, {seconds:.1f} s")


if __name__ == "__main__":
    main()
