"""Gradients through `solve_ik` are exact: against differences, for any batch, mask, limit and link parameter."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch.autograd import gradcheck

import ikgrad as ik

TIGHT = dict(tol_pos=1e-12, tol_rot=1e-12)


def question(robot: ik.Robot, rows: int = 3, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Configurations well inside the range, and their poses."""
    low, high = robot.sampling_range
    unit = torch.rand(rows, robot.dof, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    q = low + (0.2 + 0.6 * unit) * (high - low)
    return q, ik.forward_kinematics(robot, q)


@pytest.mark.parametrize("name", ["ur5e", "kr210", "puma560", "denso_vp6242"])
def test_gradcheck_with_respect_to_the_target(name: str):
    robot = ik.load_robot(name)
    q, T = question(robot)
    scale = torch.ones(4, 4, dtype=torch.float64)

    def joints(target: torch.Tensor) -> torch.Tensor:
        return ik.solve_ik(robot, target * scale, q0=q, **TIGHT).q

    assert gradcheck(joints, T.clone().requires_grad_(), eps=1e-6, atol=1e-5, rtol=1e-5)


def test_gradcheck_with_a_mask():
    robot = ik.load_robot("ur5e").with_tool(torch.eye(4))
    q, T = question(ik.load_robot("ur5e"), rows=2)
    six = ik.load_robot("arm4")
    q4, T4 = question(six, rows=2)

    def three_joints_of_a_four_joint_arm(target: torch.Tensor) -> torch.Tensor:
        return ik.forward_kinematics(six, ik.solve_ik(six, target, q0=q4, mask=(1, 1, 1, 0, 0, 0), **TIGHT).q)[:, :3, 3]

    assert gradcheck(three_joints_of_a_four_joint_arm, T4.clone().requires_grad_(), eps=1e-6, atol=1e-5)

    def hand_axis(target: torch.Tensor) -> torch.Tensor:
        return ik.forward_kinematics(robot, ik.solve_ik(robot, target, q0=q, mask=(1, 1, 1, 1, 1, 0), **TIGHT).q)[
            :, :3, 2
        ]

    assert gradcheck(hand_axis, T.clone().requires_grad_(), eps=1e-6, atol=1e-5)


@pytest.mark.parametrize("name", ["panda", "iiwa14"])
def test_redundant_arms_take_the_smallest_joint_motion(name: str):
    robot = ik.load_robot(name)
    q, T = question(robot, rows=4)
    target = T.clone().requires_grad_()
    solution = ik.solve_ik(robot, target, q0=q, **TIGHT)
    J = ik.jacobian(robot, solution.q.detach())
    pinv = torch.linalg.pinv(J)  # (4, 7, 6)
    for joint in range(robot.dof):
        (grad,) = torch.autograd.grad(solution.q[:, joint].sum(), target, retain_graph=True)
        torch.testing.assert_close(grad[:, :3, 3], pinv[:, joint, :3], rtol=1e-8, atol=1e-8)
        # a rotation w of the target changes R by [w]x R
        for axis in range(3):
            w = torch.zeros(3, 3, dtype=torch.float64)
            w[(axis + 2) % 3, (axis + 1) % 3], w[(axis + 1) % 3, (axis + 2) % 3] = 1.0, -1.0
            turned = (grad[:, :3, :3] * (w @ T[:, :3, :3])).sum(dim=(1, 2))
            torch.testing.assert_close(turned, pinv[:, joint, 3 + axis], rtol=1e-8, atol=1e-8)


def test_a_second_derivative_is_refused(panda: ik.Robot):
    T = ik.forward_kinematics(panda, ik.sample_configurations(panda, 3, seed=0)).requires_grad_()
    (first,) = torch.autograd.grad(ik.solve_ik(panda, T).q.square().sum(), T, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        first.square().sum().backward()


@pytest.mark.parametrize("shape", [(), (2, 1, 3), (0,)])
def test_any_batch_shape_and_several_solutions(panda: ik.Robot, shape: tuple[int, ...]):
    q, T = question(panda, rows=math.prod(shape))
    target = T.reshape(*shape, 4, 4).clone().requires_grad_()
    for k in (1, 2):
        solution = ik.solve_ik(panda, target, q0=q.reshape(*shape, 7), solutions=k)
        assert solution.q.requires_grad
        (grad,) = torch.autograd.grad(solution.q.square().sum(), target)
        assert grad.shape == target.shape
        assert bool(grad.isfinite().all())


def test_failed_rows_have_zero_gradient_and_others_are_untouched(panda: ik.Robot):
    q, T = question(panda)
    T[1, :3, 3] = 9.0
    target = T.clone().requires_grad_()
    solution = ik.solve_ik(panda, target, q0=q)
    (grad,) = torch.autograd.grad(solution.q.sum(), target)
    assert solution.success.tolist() == [True, False, True]
    assert float(grad[1].abs().max()) == 0.0
    alone = T[2].clone().requires_grad_()
    (single,) = torch.autograd.grad(ik.solve_ik(panda, alone, q0=q[2]).q.sum(), alone)
    torch.testing.assert_close(grad[2], single, rtol=1e-9, atol=1e-9)


def test_joints_at_a_limit_are_held(panda: ik.Robot):
    q, _ = question(panda, rows=1)
    narrow = tuple(v._replace(q_max=float(q[0, 2])) if i == 2 else v for i, v in enumerate(panda.variables))
    robot = replace(panda, variables=narrow, _tables={})
    T = ik.forward_kinematics(robot, q).requires_grad_()
    solution = ik.solve_ik(robot, T, q0=q)
    assert float((solution.q.detach() - q).abs().max()) < 1e-6
    if bool(solution.q[0, 2] == robot.q_max[2]):
        grads = [torch.autograd.grad(solution.q[0, j], T, retain_graph=True)[0] for j in range(7)]
        assert float(grads[2].abs().max()) == 0.0
        free = [0, 1, 3, 4, 5, 6]
        pinv = torch.linalg.pinv(ik.jacobian(robot, solution.q.detach())[0][:, free])
        for row, joint in enumerate(free):
            torch.testing.assert_close(grads[joint][0, :3, 3], pinv[row, :3], rtol=1e-7, atol=1e-7)
    else:
        pytest.fail("the solution left the limit it started at")


def test_a_singular_configuration_has_a_finite_gradient():
    robot = ik.load_robot("ur5e")
    q = torch.tensor([0.3, -1.0, 1.2, 0.4, 0.0, 0.2], dtype=torch.float64)  # wrist 2 at 0: two axes coincide
    T = ik.forward_kinematics(robot, q).requires_grad_()
    solution = ik.solve_ik(robot, T, q0=q)
    (grad,) = torch.autograd.grad(solution.q.sum(), T)
    assert bool(grad.isfinite().all())
    J = ik.jacobian(robot, solution.q.detach())
    expected = torch.linalg.pinv(J).mT @ torch.ones(6, dtype=torch.float64)
    torch.testing.assert_close(grad[:3, 3], expected[:3], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["kr210", "ur5e"])
def test_gradcheck_with_respect_to_link_parameters(name: str):
    robot = ik.load_robot(name)
    q, T = question(robot, rows=2)
    now = robot.tables()

    def joints(shift: torch.Tensor, tool_shift: torch.Tensor) -> torch.Tensor:
        origins = now.origins.clone()
        origins = torch.cat(
            [torch.cat([origins[:, :3, :3], (origins[:, :3, 3] + shift)[..., None]], -1), origins[:, 3:]], 1
        )
        top = torch.cat([now.tool[:3, :3], (now.tool[:3, 3] + tool_shift)[:, None]], -1)
        changed = robot.with_geometry(origins=origins, tool=torch.cat([top, now.tool[3:]]))
        return ik.solve_ik(changed, T, q0=q, **TIGHT).q

    zero = torch.zeros(len(now.origins), 3, dtype=torch.float64).requires_grad_()
    tool = torch.zeros(3, dtype=torch.float64).requires_grad_()
    assert gradcheck(joints, (zero, tool), eps=1e-6, atol=1e-5, rtol=1e-5)


def test_no_graph_is_built_when_nobody_asks(panda: ik.Robot):
    q, T = question(panda)
    assert not ik.solve_ik(panda, T, q0=q).q.requires_grad
    with torch.no_grad():
        assert not ik.solve_ik(panda, T.requires_grad_(), q0=q).q.requires_grad


def test_the_geometry_replaces_the_chain_everywhere(robot: ik.Robot):
    q = ik.sample_configurations(robot, 4, seed=0)
    now = robot.tables()
    same = robot.with_geometry(origins=now.origins.clone(), tool=now.tool.clone())
    torch.testing.assert_close(ik.forward_kinematics(same, q), ik.forward_kinematics(robot, q), rtol=1e-13, atol=1e-13)
    torch.testing.assert_close(ik.link_poses(same, q), ik.link_poses(robot, q), rtol=1e-13, atol=1e-13)
    torch.testing.assert_close(ik.jacobian(same, q), ik.jacobian(robot, q), rtol=1e-12, atol=1e-12)
    chain = same.chain.forward_kinematics(same.expand(q)).get_matrix()
    torch.testing.assert_close(chain, ik.forward_kinematics(robot, q), rtol=1e-13, atol=1e-13)
    longer = now.tool.clone()
    longer[2, 3] += 0.1
    moved = robot.with_geometry(tool=longer)
    assert moved.fingerprint not in (robot.fingerprint, same.fingerprint)
    shift = torch.linalg.inv(now.tool) @ longer
    torch.testing.assert_close(ik.forward_kinematics(moved, q), ik.forward_kinematics(robot, q) @ shift)
    with pytest.raises(ik.ShapeError, match=r"tool must have shape \(4, 4\) for robot"):
        robot.with_geometry(tool=torch.eye(3))
