"""Pose encodings: what they mean, where they are zero, and that none loses the rotation."""

from __future__ import annotations

import pytest
import roma
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.networks.encodings import ENCODINGS, encode_pose, feature_names, roll_pitch_yaw
from ikgrad.rotations import matrix_from_quat_wxyz


def random_poses(*shape: int, seed: int = 0) -> Tensor:
    robot = ik.load_robot("ur5e")
    q = ik.sample_configurations(robot, max(1, int(torch.tensor(shape).prod())), seed=seed)
    return ik.forward_kinematics(robot, q).reshape(*shape, 4, 4)


def rotation_from(features: Tensor, encoding: str) -> Tensor:
    """The inverse of each encoding, by roma or by columns."""
    if encoding == "rotation_vector":
        return roma.rotvec_to_rotmat(features)
    if encoding == "roll_pitch_yaw":
        return roma.euler_to_rotmat("xyz", features)
    if encoding == "quaternion":
        return matrix_from_quat_wxyz(features)
    a, b = features[..., :3], features[..., 3:]
    return torch.stack([a, b, torch.linalg.cross(a, b)], dim=-1)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_features_give_the_pose_back(encoding: str, shape: tuple[int, ...]):
    T, reference = random_poses(*shape), random_poses(1, seed=9)[0]
    features = encode_pose(T, reference, encoding=encoding)
    assert features.shape == (*shape, len(feature_names(encoding)))
    assert torch.allclose(features[..., :3] + reference[:3, 3], T[..., :3, 3], atol=1e-15)
    R = reference[:3, :3] @ rotation_from(features[..., 3:], encoding)
    assert torch.allclose(R, T[..., :3, :3], atol=1e-12)


@pytest.mark.parametrize("encoding", ["rotation_vector", "roll_pitch_yaw"])
def test_the_reference_is_zero(encoding: str):
    T = random_poses(1)[0]
    assert encode_pose(T, T, encoding=encoding).abs().max() < 1e-15


def test_the_quaternion_has_one_sign_only():
    assert (encode_pose(random_poses(500), torch.eye(4).double(), encoding="quaternion")[:, 3] >= 0).all()


def test_roll_pitch_yaw_turns_about_fixed_axes():
    angles = torch.tensor([0.3, -0.7, 2.0], dtype=torch.float64)
    assert torch.allclose(roll_pitch_yaw(roma.euler_to_rotmat("xyz", angles)), angles, atol=1e-14)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_gradients_are_right_and_finite_at_the_reference(encoding: str):
    robot = ik.load_robot("ur5e")
    reference = random_poses(1, seed=3)[0]
    q = ik.sample_configurations(robot, 2, seed=0).requires_grad_()

    def features(q: Tensor) -> Tensor:
        return encode_pose(ik.forward_kinematics(robot, q), reference, encoding=encoding)

    assert torch.autograd.gradcheck(features, q)
    T = reference.clone().requires_grad_()
    (grad,) = torch.autograd.grad(encode_pose(T, reference, encoding=encoding).sum(), T)
    assert grad.isfinite().all()


def test_wrong_names_and_shapes_are_refused():
    with pytest.raises(ik.UnknownNameError, match="unknown pose encoding 'quat'"):
        encode_pose(torch.eye(4), torch.eye(4), encoding="quat")
    with pytest.raises(ik.ShapeError, match=r"T must have shape \(\.\.\., 4, 4\), got \(3, 3\)"):
        encode_pose(torch.eye(3), torch.eye(4))
