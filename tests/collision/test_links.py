"""Links as segments: kernel, torch and other robots agree; what has no length is left out."""

from __future__ import annotations

import math

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

import ikgrad as ik
from ikgrad.collision import link_pairs, link_segments
from ikgrad.collision.links import plain_link_segments


@pytest.mark.parametrize("batch", [(), (1,), (3, 1, 2), (0,), (21,)])
def test_segments_run_from_link_origin_to_link_origin(robot: ik.Robot, batch: tuple[int, ...]):
    q = ik.sample_configurations(robot, math.prod(batch), seed=1).reshape(*batch, robot.dof)
    links = link_segments(robot, q)
    pairs = link_pairs(robot)
    assert links.shape == (*batch, len(pairs), 2, 3)
    where = dict(zip(robot.link_names, ik.link_poses(robot, q)[..., :3, 3].unbind(-2), strict=True))
    for i, (start, end) in enumerate(pairs):
        torch.testing.assert_close(links[..., i, 0, :], where[start], rtol=0, atol=1e-12)
        torch.testing.assert_close(links[..., i, 1, :], where[end], rtol=0, atol=1e-12)


def test_what_is_left_out_never_has_a_length(robot: ik.Robot):
    origins = ik.link_poses(robot, ik.sample_configurations(robot, 200, seed=2))[..., :3, 3]
    lengths = (origins[:, 1:] - origins[:, :-1]).norm(dim=-1).amax(dim=0)
    kept = {end for _, end in link_pairs(robot)}
    for length, name in zip(lengths.tolist(), robot.link_names[1:], strict=True):
        assert (length > 1e-9) == (name in kept)


def test_gradient_of_the_kernel_equals_that_of_torch(robot: ik.Robot):
    q = ik.sample_configurations(robot, 19, seed=3)
    grad = torch.randn(link_segments(robot, q).shape, generator=torch.Generator().manual_seed(0)).double()
    pulled = []
    for f in (link_segments, plain_link_segments):
        x = q.clone().requires_grad_()
        pulled.append(torch.autograd.grad(f(robot, x), x, grad)[0])
    torch.testing.assert_close(pulled[0], pulled[1], rtol=1e-12, atol=1e-12)


def test_first_and_second_derivatives(robot: ik.Robot):
    q = ik.sample_configurations(robot, 1, seed=4).requires_grad_()
    assert gradcheck(lambda q: link_segments(robot, q), q, atol=1e-5)
    assert gradgradcheck(lambda q: link_segments(robot, q), q, atol=1e-4)


def test_the_tool_is_the_last_link(panda: ik.Robot):
    tool = torch.eye(4)
    tool[:3, 3] = torch.tensor([0.05, 0.0, 0.2])
    robot = panda.with_tool(tool, name="gripper")
    assert link_pairs(robot)[-1] == ("panda_link8", "gripper")
    q = ik.sample_configurations(robot, 5, seed=5)
    torch.testing.assert_close(link_segments(robot, q)[:, -1, 1], ik.forward_kinematics(robot, q)[:, :3, 3])
    with_new_tool = panda.with_tool(torch.eye(4), name="gripper").with_geometry(tool=robot.tables().tool)
    torch.testing.assert_close(link_segments(with_new_tool, q)[:, -1, 1], ik.forward_kinematics(robot, q)[:, :3, 3])


def test_float32_and_wrong_shapes(panda: ik.Robot):
    q = ik.sample_configurations(panda, 5, seed=6)
    single = link_segments(panda, q.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), link_segments(panda, q), rtol=0, atol=2e-6)
    with pytest.raises(ik.ShapeError, match=r"q must have shape \(\.\.\., 7\) for robot 'panda', got \(5, 6\)"):
        link_segments(panda, q[:, :6])
