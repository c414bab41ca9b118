"""Pose encodings: what a network sees of a pose, by name.

All start with the three coordinates of the position in the base frame, less those of a reference pose [m]; then comes
the rotation relative to the reference, ``R_ref^T R``, in one of four forms. A reference in the middle of the work keeps
the jumps that every form of three or four numbers has (half a turn away, or a quarter in pitch) out of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import UnknownNameError
from ikgrad.kinematics import check_poses
from ikgrad.rotations import drawn_atan2, drawn_log_rotation, log_rotation, quat_wxyz_from_matrix


def roll_pitch_yaw(R: Tensor) -> Tensor:
    """Angles of ``R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll)``; roll and yaw jump at +-pi, pitch is singular at +-pi/2.

    Args:
        R: (..., 3, 3)

    Returns:
        (..., 3) roll, pitch, yaw [rad].

    Example:
        >>> quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        >>> roll_pitch_yaw(quarter).abs()
        tensor([0.0000, 0.0000, 1.5708])
    """
    arc = drawn_atan2 if torch.compiler.is_exporting() else torch.atan2
    roll = arc(R[..., 2, 1], R[..., 2, 2])
    pitch = arc(-R[..., 2, 0], R[..., 2, 1:].norm(dim=-1))
    yaw = arc(R[..., 1, 0], R[..., 0, 0])
    return torch.stack([roll, pitch, yaw], dim=-1)


def rotation_vector(R: Tensor) -> Tensor:
    """`log_rotation`; where a graph is drawn for another program, in operations that runtimes have in float64.

    Example:
        >>> rotation_vector(torch.eye(3)).tolist()
        [0.0, 0.0, 0.0]
    """
    return drawn_log_rotation(R) if torch.compiler.is_exporting() else log_rotation(R)


def rotation_6d(R: Tensor) -> Tensor:
    """The first two columns of a rotation matrix, one after the other: no jump and no singularity anywhere.

    Args:
        R: (..., 3, 3)

    Returns:
        (..., 6)

    Source:
        Zhou et al., On the continuity of rotation representations in neural networks (2019), section 4.2.

    Example:
        >>> rotation_6d(torch.eye(3)).tolist()
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    """
    return R[..., :2].mT.flatten(-2)


class Encoding(NamedTuple):
    """A form of the relative rotation.

    Attributes:
        function: (..., 3, 3) -> (..., k).
        names: of the k numbers, with units.
    """

    function: Callable[[Tensor], Tensor]
    names: tuple[str, ...]


ENCODINGS = {
    "rotation_vector": Encoding(rotation_vector, ("rx [rad]", "ry [rad]", "rz [rad]")),
    "roll_pitch_yaw": Encoding(roll_pitch_yaw, ("roll [rad]", "pitch [rad]", "yaw [rad]")),
    "quaternion": Encoding(quat_wxyz_from_matrix, ("qw", "qx", "qy", "qz")),  # w >= 0 fixes the sign
    "rotation_6d": Encoding(rotation_6d, ("r11", "r21", "r31", "r12", "r22", "r32")),
}


def encode_pose(T: Tensor, reference: Tensor, *, encoding: str = "rotation_vector") -> Tensor:
    """Features of poses: position less the reference's, and rotation relative to it.

    Args:
        T: (..., 4, 4) poses [m].
        reference: (4, 4) pose that becomes zero.
        encoding: form of the rotation: rotation_vector, roll_pitch_yaw, quaternion (w, x, y, z with w >= 0) or
            rotation_6d.

    Returns:
        (..., k), in the order of `feature_names`.

    Raises:
        ShapeError: the last two dimensions are not (4, 4).
        UnknownNameError: no such encoding.

    Example:
        >>> T = torch.eye(4).repeat(5, 1, 1)
        >>> encode_pose(T, torch.eye(4)).shape, encode_pose(T, torch.eye(4), encoding="rotation_6d").shape
        (torch.Size([5, 6]), torch.Size([5, 9]))
    """
    check_poses("T", T)
    position = T[..., :3, 3] - reference[:3, 3]
    return torch.cat([position, _known(encoding).function(reference[:3, :3].mT @ T[..., :3, :3])], dim=-1)


def feature_names(encoding: str) -> tuple[str, ...]:
    """Names of the features of `encode_pose`, with units.

    Raises:
        UnknownNameError: no such encoding.
    """
    return ("x [m]", "y [m]", "z [m]", *_known(encoding).names)


def _known(encoding: str) -> Encoding:
    if encoding not in ENCODINGS:
        raise UnknownNameError("pose encoding", encoding, ENCODINGS)
    return ENCODINGS[encoding]


__all__ = ["ENCODINGS", "Encoding", "encode_pose", "feature_names", "roll_pitch_yaw", "rotation_6d", "rotation_vector"]
