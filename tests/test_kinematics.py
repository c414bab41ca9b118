"""FK, Jacobian and pose error: any batch shape, derivatives, and the oracles."""

from __future__ import annotations

import math

import pytest
import torch
from support import BUILTIN
from torch.autograd import gradcheck, gradgradcheck

import ikgrad as ik
from ikgrad.rotations import (
    log_rotation,
    matrix_from_quat_wxyz,
    nearest_rotation,
    quat_wxyz_from_matrix,
    rotation_angle,
)

SHAPES = [(), (1,), (3, 1, 2), (0,), (2, 0, 3)]


def configurations(robot: ik.Robot, shape: tuple[int, ...], seed: int = 0) -> torch.Tensor:
    return ik.sample_configurations(robot, math.prod(shape), seed=seed).reshape(*shape, robot.dof)


def rotation(vector: torch.Tensor) -> torch.Tensor:
    """exp of a rotation vector by the matrix exponential, as an oracle."""
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3)))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [0, 1])
def test_batched_equals_looped_and_inputs_are_not_modified(robot: ik.Robot, shape: tuple[int, ...], seed: int):
    q = configurations(robot, shape, seed)
    before = q.clone()
    for function in (ik.forward_kinematics, ik.jacobian, ik.link_poses):
        batched = function(robot, q)
        assert batched.shape[: len(shape)] == shape
        for index, row in enumerate(q.reshape(-1, robot.dof)):
            single = function(robot, row)
            torch.testing.assert_close(batched.reshape(-1, *single.shape)[index], single, rtol=1e-13, atol=1e-13)
    assert torch.equal(q, before)


def test_link_poses_end_at_the_tip_and_start_at_the_base(robot: ik.Robot):
    q = configurations(robot, (4,))
    poses = ik.link_poses(robot, q)
    assert poses.shape == (4, len(robot.link_names), 4, 4)
    torch.testing.assert_close(poses[:, 0], torch.eye(4, dtype=q.dtype).expand(4, 4, 4))
    torch.testing.assert_close(poses[:, -1], ik.forward_kinematics(robot, q), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_results_have_the_dtype_of_q(robot: ik.Robot, dtype: torch.dtype):
    q = configurations(robot, (5,)).to(dtype)
    T, J = ik.forward_kinematics(robot, q), ik.jacobian(robot, q)
    assert T.dtype == J.dtype == dtype
    torch.testing.assert_close(T.double(), ik.forward_kinematics(robot, q.double()), rtol=1e-5, atol=1e-5)


def test_fk_and_jacobian_pass_gradcheck_twice(robot: ik.Robot):
    q = configurations(robot, (2,)).requires_grad_()
    scale = robot.length

    def pose(x: torch.Tensor) -> torch.Tensor:
        return ik.forward_kinematics(robot, x) / scale

    assert gradcheck(pose, q)
    assert gradgradcheck(pose, q)
    assert gradcheck(lambda x: ik.jacobian(robot, x) / scale, q)


def test_fk_works_under_vmap_and_jacrev(panda: ik.Robot):
    q = configurations(panda, (4,))
    T = torch.func.vmap(lambda x: ik.forward_kinematics(panda, x))(q)
    torch.testing.assert_close(T, ik.forward_kinematics(panda, q))
    dp = torch.func.jacrev(lambda x: ik.forward_kinematics(panda, x)[:3, 3])(q[0])
    torch.testing.assert_close(dp, ik.jacobian(panda, q[0])[:3])


def test_jacobian_equals_central_differences_of_the_pose_error(robot: ik.Robot):
    q, h = configurations(robot, (6,)), 1e-6
    J = ik.jacobian(robot, q)
    for k in range(robot.dof):
        step = torch.zeros(robot.dof, dtype=q.dtype)
        step[k] = h
        low, high = ik.forward_kinematics(robot, q - step), ik.forward_kinematics(robot, q + step)
        column = ik.pose_error(low, high) / (2 * h)
        torch.testing.assert_close(column, J[..., k], rtol=1e-7, atol=1e-8 * max(1.0, robot.length))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-4, 0.5, 3.0, math.pi - 1e-4, math.pi - 1e-8, math.pi])
def test_pose_error_is_exact_at_small_angles_and_near_pi(angle: float):
    for axis in ((1.0, 0, 0), (0, 0, 1.0), (1.0, 2.0, -2.0), (0.1, -3.0, 0.2)):
        unit = torch.tensor(axis, dtype=torch.float64) / torch.tensor(axis, dtype=torch.float64).norm()
        T, target = torch.eye(4, dtype=torch.float64), torch.eye(4, dtype=torch.float64)
        target[:3, :3] = rotation(angle * unit)
        e = ik.pose_error(T, target)[3:]
        assert abs(float(e.norm()) - angle) < 1e-14 + 1e-9 * (angle > 3)
        same, opposite = (e - angle * unit).norm(), (e + angle * unit).norm()
        assert float(same if angle < 3.14 else min(same, opposite)) < 1e-12 + 1e-7 * (angle > 3)
        if angle < 3:
            assert abs(float(rotation_angle(target[:3, :3])) - angle) < 1e-15


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, math.pi - 1e-7, math.pi])
def test_pose_error_has_finite_gradients_everywhere(angle: float):
    target = torch.eye(4, dtype=torch.float64)
    target[:3, :3] = rotation(torch.tensor([0.0, angle, 0.0], dtype=torch.float64))
    T = torch.eye(4, dtype=torch.float64).requires_grad_()
    (gradient,) = torch.autograd.grad(ik.pose_error(T, target).sum(), T)
    assert bool(gradient.isfinite().all())


def test_pose_error_points_from_the_pose_to_the_target():
    generator = torch.Generator().manual_seed(0)
    v, w = torch.randn(2, 50, 3, dtype=torch.float64, generator=generator)
    T, target = torch.eye(4, dtype=torch.float64).repeat(2, 50, 1, 1)
    T[:, :3, :3], target[:, :3, :3] = rotation(v), rotation(w)
    T[:, :3, 3], target[:, :3, 3] = w, v
    e = ik.pose_error(T, target)
    torch.testing.assert_close(rotation(e[:, 3:]) @ T[:, :3, :3], target[:, :3, :3], rtol=0, atol=1e-13)
    torch.testing.assert_close(T[:, :3, 3] + e[:, :3], target[:, :3, 3])
    assert float(ik.pose_error(T, T).abs().max()) < 1e-15


def test_pose_error_broadcasts():
    T = torch.eye(4, dtype=torch.float64)
    assert ik.pose_error(T.expand(5, 1, 4, 4), T.expand(3, 4, 4)).shape == (5, 3, 6)


@pytest.mark.parametrize("bad", [torch.zeros(5), torch.zeros(3, 8), torch.tensor(0.0)])
def test_wrong_shapes_name_the_robot_and_the_shape(panda: ik.Robot, bad: torch.Tensor):
    text = rf"q must have shape \(\.\.\., 7\) for robot 'panda', got \({', '.join(map(str, bad.shape))},?\)"
    for function in (ik.forward_kinematics, ik.jacobian, ik.link_poses):
        with pytest.raises(ik.ShapeError, match=text):
            function(panda, bad)


def test_wrong_dtypes_are_refused(panda: ik.Robot):
    with pytest.raises(ik.ShapeError, match=r"q must be a floating-point tensor, got torch.int64"):
        ik.forward_kinematics(panda, torch.zeros(7, dtype=torch.int64))
    with pytest.raises(ik.ShapeError, match="T must be a floating-point tensor, got list"):
        ik.pose_error([[1.0]], torch.eye(4))
    with pytest.raises(ik.ShapeError, match=r"T_target must have shape \(..., 4, 4\), got \(3, 4\)"):
        ik.pose_error(torch.eye(4), torch.zeros(3, 4))


def test_quaternions_round_trip():
    generator = torch.Generator().manual_seed(0)
    quat_wxyz = torch.nn.functional.normalize(torch.randn(200, 4, dtype=torch.float64, generator=generator), dim=-1)
    quat_wxyz = quat_wxyz * quat_wxyz[:, :1].sign()
    R = matrix_from_quat_wxyz(3.0 * quat_wxyz)
    torch.testing.assert_close(quat_wxyz_from_matrix(R), quat_wxyz, rtol=0, atol=1e-14)
    torch.testing.assert_close(log_rotation(R).norm(dim=-1), rotation_angle(R), rtol=0, atol=1e-7)


def test_nearest_rotation_undoes_a_stretch():
    generator = torch.Generator().manual_seed(0)
    R = rotation(torch.randn(20, 3, dtype=torch.float64, generator=generator))
    stretch = torch.diag(torch.tensor([1.1, 0.9, 1.3], dtype=torch.float64))
    torch.testing.assert_close(nearest_rotation(R @ stretch), R, rtol=0, atol=1e-14)
    reflected = nearest_rotation(-torch.eye(3))
    assert float(torch.linalg.det(reflected)) > 0.99


# --- sampling -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sobol", [False, True])
def test_samples_are_inside_the_limits_and_follow_the_seed(robot: ik.Robot, sobol: bool):
    q = ik.sample_configurations(robot, 300, seed=5, sobol=sobol)
    low, high = robot.sampling_range
    assert q.shape == (300, robot.dof)
    assert q.dtype == torch.float64
    assert bool(((q >= low) & (q <= high)).all())
    assert torch.equal(q, ik.sample_configurations(robot, 300, seed=5, sobol=sobol))
    assert not torch.equal(q, ik.sample_configurations(robot, 300, seed=6, sobol=sobol))
    spread = (q.amax(0) - q.amin(0)) / (high - low)
    assert float(spread.min()) > 0.9


def test_a_sobol_sequence_covers_more_evenly(panda: ik.Robot):
    def gaps(sobol: bool) -> float:
        q = ik.sample_configurations(panda, 512, seed=0, sobol=sobol).sort(dim=0).values
        return float((q.diff(dim=0) / (panda.q_max - panda.q_min)).max())

    assert gaps(True) < 0.5 * gaps(False)


def test_sampling_refuses_a_negative_count(panda: ik.Robot):
    with pytest.raises(ik.ConfigError, match="count must not be negative, got -1"):
        ik.sample_configurations(panda, -1, seed=0)


# --- what the papers say of their robots --------------------------------------------------------------------------


def degrees(*values: float) -> torch.Tensor:
    return torch.deg2rad(torch.tensor(values, dtype=torch.float64))


def test_kr210_at_zero_and_at_the_start_of_the_apps_paper():
    robot = ik.load_robot("kr210")
    T = ik.forward_kinematics(robot, degrees(0, 0, 0, 0, 0, 0))
    torch.testing.assert_close(T[:3, 3], torch.tensor([1.541, 0, 2.09], dtype=torch.float64), rtol=0, atol=1e-15)
    torch.testing.assert_close(T[:3, :3].diagonal(), torch.tensor([1.0, -1, -1], dtype=torch.float64))
    T = ik.forward_kinematics(robot, degrees(0.01, -78.33, 183.51, 0.16, -44.87, -179.93))
    expected = torch.tensor([1.916784, 0.000089, 1.553926], dtype=torch.float64)
    torch.testing.assert_close(T[:3, 3], expected, rtol=0, atol=5e-7)  # printed to six decimals


def test_denso_home_is_the_printed_one():
    T = ik.forward_kinematics(ik.load_robot("denso_vp6242"), degrees(0, 90, 180, 0, -90, 0))
    expected = torch.diag(torch.tensor([-1.0, 1, -1, 1], dtype=torch.float64))
    expected[:3, 3] = torch.tensor([0.21, 0, 0.24])
    torch.testing.assert_close(T, expected, rtol=0, atol=1e-7)  # torch.tensor above is float32 for 0.21
    assert float((T[:3, 3] - torch.tensor([0.21, 0, 0.24], dtype=torch.float64)).abs().max()) < 1e-12


@pytest.mark.parametrize(
    ("q_deg", "expected"),
    [
        ((0, 0, 0, 0), (30, 0, 0)),
        ((10, 20, 30, 40), (15.5844, 2.7480, 21.0807)),
        ((30, 15, 25, 35), (17.2407, 9.9540, 18.6753)),
        ((60, 35, 25, 15), (7.8899, 13.6656, 24.0553)),
    ],
)
def test_arm4_passes_the_points_of_the_trajectory_paper(q_deg: tuple, expected: tuple):
    T = ik.forward_kinematics(ik.load_robot("arm4"), degrees(*q_deg))
    torch.testing.assert_close(T[:3, 3], torch.tensor(expected, dtype=torch.float64), rtol=0, atol=2e-4)


def test_puma_meets_the_first_row_of_its_paper():
    T = ik.forward_kinematics(ik.load_robot("puma560"), degrees(73.76, -19.79, 129.71, 0, 70.08, 73.76))
    expected = torch.tensor([0.08635, 0.82934, 0.67194], dtype=torch.float64)
    assert float((T[:3, 3] - expected).abs().max()) < 8e-5  # joints printed to 0.01 deg
    torch.testing.assert_close(T[:3, :3].diagonal(), torch.tensor([-1.0, 1, -1], dtype=torch.float64))


def test_makers_flange_positions():
    """Upright or stretched poses whose flange position follows from the data sheets' lengths alone."""
    zero = {name: torch.zeros(ik.load_robot(name).dof, dtype=torch.float64) for name in BUILTIN}
    position = {name: ik.forward_kinematics(ik.load_robot(name), q)[:3, 3].tolist() for name, q in zero.items()}
    assert position["panda"] == pytest.approx([0.088, 0, 0.333 + 0.316 + 0.384 - 0.107], abs=1e-12)
    assert position["ur5e"] == pytest.approx([-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997], abs=1e-12)
    assert position["iiwa14"] == pytest.approx([0, 0, 0.36 + 0.42 + 0.4 + 0.126], abs=1e-12)
