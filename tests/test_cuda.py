"""The tensor paths on a GPU: same answers as on the CPU, results stay where the inputs are. Skipped without one."""

from __future__ import annotations

import pytest
import torch
from support import BUILTIN

import ikgrad as ik
from ikgrad.collision import Capsules, PolynomialMotion, Spheres, check_motion, clearance_residual, link_segments

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_kinematics_on_the_gpu_equal_those_on_the_cpu(name: str, dtype: torch.dtype):
    robot = ik.load_robot(name)
    q = ik.sample_configurations(robot, 1000, seed=0).to(dtype)
    tolerance = dict(rtol=1e-12, atol=1e-12) if dtype == torch.float64 else dict(rtol=2e-4, atol=2e-5)
    for function in (ik.forward_kinematics, ik.jacobian, ik.link_poses):
        there = function(robot, q.cuda())
        assert there.is_cuda
        assert there.dtype == dtype
        torch.testing.assert_close(there.cpu(), function(robot, q), **tolerance)
    T = ik.forward_kinematics(robot, q.cuda())
    torch.testing.assert_close(
        ik.pose_error(T[:500], T[500:]).cpu(), ik.pose_error(T[:500].cpu(), T[500:].cpu()), rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("name", BUILTIN)
def test_solve_ik_on_the_gpu(name: str):
    robot = ik.load_robot(name)
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 2000, seed=1)).cuda()
    solution = ik.solve_ik(robot, T)
    assert solution.q.is_cuda
    assert float(solution.success.double().mean()) >= 0.999
    e = ik.pose_error(ik.forward_kinematics(robot, solution.q), T)[solution.success]
    assert float(e[:, :3].norm(dim=-1).max()) < 1.0001e-6
    inside = (solution.q.cpu() >= robot.q_min) & (solution.q.cpu() <= robot.q_max)
    assert bool(inside[solution.success.cpu()].all())


@pytest.mark.parametrize("method", [ik.NewtonRaphson(), ik.Apps(max_steps=3000)], ids=lambda m: type(m).__name__)
def test_the_other_methods_run_there_too(method):
    robot = ik.load_robot("kr210")
    q = torch.deg2rad(torch.tensor([[10.0, -70, 180, 20, -45, 30]], dtype=torch.float64, device="cuda"))
    T = ik.forward_kinematics(robot, q)
    assert bool(ik.solve_ik(robot, T, q0=q + 0.05, solver=method, tol_pos=1e-4, tol_rot=1e-4).success.all())


def test_gradients_through_ik_on_the_gpu():
    robot = ik.load_robot("panda")
    q = robot.q_min + (robot.q_max - robot.q_min) * torch.linspace(0.3, 0.7, 5, dtype=torch.float64)[:, None]
    grads = []
    for device in ("cpu", "cuda"):
        T = ik.forward_kinematics(robot, q.to(device)).requires_grad_()
        solution = ik.solve_ik(robot, T, q0=q.to(device))
        grads.append(torch.autograd.grad(solution.q.sin().sum(), T)[0].cpu())
    torch.testing.assert_close(grads[0], grads[1], rtol=1e-5, atol=1e-5)


def test_several_solutions_and_bad_rows_on_the_gpu():
    robot = ik.load_robot("ur5e")
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 4, seed=2)).cuda()
    T[1, 0, 0] = float("nan")
    solution = ik.solve_ik(robot, T, solutions=3)
    assert solution.reason[1].tolist() == ["invalid_target"] * 3
    assert bool(solution.success[0].all())


BALLS = [[0.45, 0.1, 0.4], [-0.3, 0.4, 0.6], [0.0, -0.5, 0.3]]


def balls(device: str) -> Spheres:
    return Spheres(torch.tensor(BALLS, device=device).double(), torch.full((3,), 0.12, device=device).double())


def poles(device: str) -> Capsules:
    ends = torch.tensor([[b, [b[0], b[1], 0.0]] for b in BALLS], device=device).double()
    return Capsules(ends, torch.full((3,), 0.08, device=device).double())


@pytest.mark.parametrize("obstacles", [balls, poles])
def test_distances_and_their_gradients_on_the_gpu_equal_those_on_the_cpu(obstacles):
    robot = ik.load_robot("panda")
    q = ik.sample_configurations(robot, 500, seed=0)
    found = []
    for device in ("cpu", "cuda"):
        x = q.to(device).requires_grad_()
        distance = obstacles(device).distance(link_segments(robot, x), 0.05)
        residual = clearance_residual(robot, obstacles(device), link_radius=0.05)(x)
        (grad,) = torch.autograd.grad(distance.sin().sum() + residual.square().sum(), x)
        assert distance.device.type == residual.device.type == grad.device.type == device
        found.append([value.detach().cpu() for value in (distance, residual, grad)])
    for here, there in zip(*found, strict=True):
        torch.testing.assert_close(here, there, rtol=1e-9, atol=1e-10)


def test_motions_are_judged_on_the_gpu_as_on_the_cpu():
    robot = ik.load_robot("panda")
    a, b = ik.sample_configurations(robot, 200, seed=1).chunk(2)
    verdicts = []
    for device in ("cpu", "cuda"):
        coefficients = torch.stack([a, b - a], dim=1)[:, None].to(device)
        motion = PolynomialMotion(torch.tensor([0.0, 1.0], device=device), coefficients)
        verdicts.append(check_motion(robot, motion, balls(device), link_radius=0.05))
    assert verdicts[1].free.is_cuda
    for name in ("free", "touches", "link", "obstacle"):
        assert torch.equal(getattr(verdicts[0], name), getattr(verdicts[1], name).cpu())


def test_trajectories_are_optimised_on_the_gpu():
    robot = ik.load_robot("panda")
    q = ik.sample_configurations(robot, 600, seed=2)
    q = q[balls("cpu").distance(link_segments(robot, q), 0.05).amin(dim=(1, 2)) >= 0.02][:200].cuda()
    found = ik.optimize_trajectory(robot, q[:100], q[100:], balls("cuda"), link_radius=0.05, velocity_max=2.0)
    assert found.success.is_cuda
    assert found.trajectory.coefficients.is_cuda
    assert float(found.success.double().mean()) >= 0.9
    here = ik.optimize_trajectory(robot, q[:100].cpu(), q[100:].cpu(), balls("cpu"), link_radius=0.05, velocity_max=2.0)
    assert int((here.success != found.success.cpu()).sum()) <= 3


@pytest.mark.parametrize("model", ["unrolled", "increment"])
def test_inverters_are_trained_on_the_gpu(model):
    options = dict(robot="panda", model=model, width=32, batch_size=256, steps=30, checks=5)
    there, here = ik.train(**options, device="cuda"), ik.train(**options)
    assert next(there.inverter.parameters()).device.type == "cpu"
    losses = [torch.tensor([check.loss for check in result.curves[0]]) for result in (there, here)]
    torch.testing.assert_close(*losses, rtol=2e-3, atol=0)
