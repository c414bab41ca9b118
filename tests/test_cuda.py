"""The tensor paths on a GPU: same answers as on the CPU, results stay where the inputs are. Skipped without one."""

from __future__ import annotations

import pytest
import torch
from support import BUILTIN

import ikgrad as ik

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
