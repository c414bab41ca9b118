"""Rotations as 3x3 matrices, rotation vectors and unit quaternions (``quat_wxyz``)."""

from __future__ import annotations

import torch
from torch import Tensor

# 4 q q^T = unit + (flattened R) @ this, row after row, for the unit quaternion q = (w, x, y, z) of R
_UNIT = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
_TO_QUATERNION = [
    [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1],
    [0, 0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, 0],
    [0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0],
    [0, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 0],
    [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1],
    [0, -1, 0, 0, -1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0],
    [0, 0, -1, 0, 0, 0, 0, 1, -1, 0, 0, 0, 0, 1, 0, 0],
    [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0],
    [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1],
]


def log_rotation(R: Tensor) -> Tensor:
    """Rotation vector of a rotation matrix, exact at 0 and at pi, with finite gradients (by roma).

    Args:
        R: (..., 3, 3)

    Returns:
        (..., 3) axis times angle, norm in [0, pi].

    Example:
        >>> import torch
        >>> log_rotation(torch.diag(torch.tensor([1.0, -1.0, -1.0]))).abs()
        tensor([3.1416, 0.0000, 0.0000])
    """
    import roma  # imports much of torch: one second, so only where a gradient is wanted

    return roma.rotmat_to_rotvec(R)


def drawn_log_rotation(R: Tensor) -> Tensor:
    r"""`log_rotation` for graphs that are drawn and taken elsewhere: no branch, no gradient, full precision.

    The four rows of ``4 q q^T`` are linear in R; the one with the largest diagonal gives the unit quaternion
    (w, v), w >= 0, without loss anywhere in [0, pi]. Runtimes have arc functions in float32 alone, so half the angle is
    ``h = h0 + sin(h - h0) = h0 + |v| cos h0 - w sin h0`` with h0 from one of those: 1e-7 cubed is nothing.

    Args:
        R: (..., 3, 3)

    Returns:
        (..., 3) axis times angle, norm in [0, pi].

    Example:
        >>> quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
        >>> drawn_log_rotation(quarter)
        tensor([0.0000, 0.0000, 1.5708], dtype=torch.float64)
    """
    rows = (R.flatten(-2) @ R.new_tensor(_TO_QUATERNION) + R.new_tensor(_UNIT)).unflatten(-1, (4, 4))
    best = rows[..., 0, :]
    largest = rows[..., 0, :1]
    for k in (1, 2, 3):
        best = torch.where(rows[..., k, k : k + 1] > largest, rows[..., k, :], best)
        largest = torch.maximum(largest, rows[..., k, k : k + 1])
    quat_wxyz = best / best.square().sum(dim=-1, keepdim=True).sqrt()
    w, v = quat_wxyz[..., :1], quat_wxyz[..., 1:]
    v, w = torch.where(w < 0, -v, v), w.abs()
    sine = v.square().sum(dim=-1, keepdim=True).sqrt()
    half = torch.atan2(sine.float(), w.float()).to(R)
    half = half + sine * half.cos() - w * half.sin()
    return 2 * v * torch.where(sine > 0, half / torch.where(sine > 0, sine, 1.0), 1.0)


def drawn_atan2(y: Tensor, x: Tensor) -> Tensor:
    """``atan2`` for graphs that are drawn and taken elsewhere: from one in float32, by ``h = h0 + sin(h - h0)``.

    Args:
        y: (...)
        x: (...)

    Returns:
        (...) angle [rad], 0 where both are zero.

    Example:
        >>> import torch
        >>> y, x = torch.randn(2, 1000, dtype=torch.float64)
        >>> bool((drawn_atan2(y, x) - torch.atan2(y, x)).abs().max() < 1e-15)
        True
    """
    h = torch.atan2(y.float(), x.float()).to(y)
    length = (x.square() + y.square()).sqrt()
    return h + (y * h.cos() - x * h.sin()) / torch.where(length > 0, length, 1.0)


def rotation_angle(R: Tensor) -> Tensor:
    """Angle of a rotation matrix, accurate to rounding near 0: atan2(|vee(R - R^T)| / 2, (tr R - 1) / 2).

    Args:
        R: (..., 3, 3)

    Returns:
        (...) angle in [0, pi].

    Example:
        >>> import torch
        >>> rotation_angle(torch.eye(3))
        tensor(0.)
    """
    skew = torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], dim=-1)
    trace = R.diagonal(dim1=-2, dim2=-1).sum(-1)
    return torch.atan2(skew.norm(dim=-1), trace - 1)


def matrix_from_quat_wxyz(quat_wxyz: Tensor) -> Tensor:
    """Rotation matrices of quaternions (w, x, y, z); the quaternions are normalised first.

    Args:
        quat_wxyz: (..., 4), not zero.

    Returns:
        (..., 3, 3)

    Example:
        >>> import torch
        >>> matrix_from_quat_wxyz(torch.tensor([1.0, 0.0, 0.0, 0.0]))
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 1.]])
    """
    w, x, y, z = (quat_wxyz / quat_wxyz.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def quat_wxyz_from_matrix(R: Tensor) -> Tensor:
    """Unit quaternions (w, x, y, z), w >= 0, of rotation matrices (by roma).

    Args:
        R: (..., 3, 3)

    Returns:
        (..., 4)

    Example:
        >>> import torch
        >>> quat_wxyz_from_matrix(torch.eye(3))
        tensor([1., 0., 0., 0.])
    """
    import roma

    quat_wxyz = roma.quat_xyzw_to_wxyz(roma.rotmat_to_unitquat(R))
    return torch.where(quat_wxyz[..., :1] < 0, -quat_wxyz, quat_wxyz)


def nearest_rotation(M: Tensor) -> Tensor:
    """The rotation closest to a matrix in the Frobenius norm (polar decomposition by SVD).

    Args:
        M: (..., 3, 3), finite.

    Returns:
        (..., 3, 3)

    Example:
        >>> import torch
        >>> nearest_rotation(2 * torch.eye(3))
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 1.]])
    """
    U, _, Vh = torch.linalg.svd(M)
    sign = torch.ones_like(M[..., 0])
    sign[..., 2] = torch.linalg.det(U @ Vh).sign()
    return (U * sign[..., None, :]) @ Vh
