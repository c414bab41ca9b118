"""The PUMA 560 in closed form: all eight branches of any batch of poses, differentiable.

In standard frames the arm is two turns, two links in a plane, and ZYZ Euler angles (d6 = 0, so p is the wrist centre;
subtract z0 from its height first):

    R = Rz(th1) Ry(th23) Rz(th4) Ry(th5) Rz(th6),   th23 = th2 + th3
    px = c1 rho - s1 d2,   py = s1 rho + c1 d2,   rho = a2 c2 + a3 c23 + d4 s23,   pz = -a2 s2 - a3 s23 + d4 c23

The paper solves the same arm in modified frames, eqs. (2)-(31), with some twenty misprints. With its d3, d4 written as
d2, -d4 and the misprints corrected (the numbers in brackets are its equations, after correction) what is left is

    rho = +-sqrt(px^2 + py^2 - d2^2),   th1 = atan2(rho py - d2 px, rho px + d2 py)                     (8), (10), (11)
    K = (px^2 + py^2 + pz^2 - a2^2 - a3^2 - d2^2 - d4^2) / (2 a2) = a3 c3 + d4 s3                             (13), (14)
    W = +-sqrt(a3^2 + d4^2 - K^2) = a3 s3 - d4 c3,   th3 = atan2(d4 K + a3 W, a3 K - d4 W)                    (15), (16)
    A = a3 + a2 c3,   B = d4 + a2 s3,   th23 = atan2(B rho - A pz, A rho + B pz),   th2 = th23 - th3          (20), (21)
    M = Ry(-th23) Rz(-th1) R = Rz(th4) Ry(th5) Rz(th6)
    th4 = atan2(M23, M13),   th5 = atan2(c4 M13 + s4 M23, M33)                                          (24), (27)-(28)
    th6 = atan2(c4 M21 - s4 M11, c4 M22 - s4 M12)                                                             (29)-(30)
    flip: th4 + pi, -th5, th6 + pi                                                                                 (31)

th6 is taken *after* th4, so that near th5 = 0, where th4 is noise, their sum is right all the same. Every sine and
cosine above is algebraic in the pose: twenty arctangents are all the transcendental work of eight branches.
`docs/papers/puma-closed-form.md` has the derivation and what each misprint was.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd import forward_ad

from ikgrad.kinematics import check_poses
from ikgrad.robot import load_robot
from ikgrad.solvers.question import ROTATION_TOLERANCE

A2, A3, D2, D4, Z0 = 0.4318, -0.02032, 0.14909, 0.43307, 0.65415  # [m]
L2 = A3**2 + D4**2  # squared distance from elbow to wrist

BRANCHES = tuple(
    (shoulder, elbow, wrist)
    for shoulder in ("left", "right")
    for elbow in ("up", "down")
    for wrist in ("no flip", "flip")
)
"""What the eight places mean, after Lee and Ziegler. Left: rho > 0, the shoulder offset is on the left of the
direction in which the arm points; right: it reaches over its back, rho < 0. Up: the elbow is above the line from
shoulder to wrist (rho and W have the same sign). Flip: th5 < 0."""


@dataclass(frozen=True, eq=False)
class Puma560Branches:
    """All branches of a batch of poses; unpacks as ``q, valid``.

    Attributes:
        q: (..., 8, 6) joint values [rad], always finite, in the order of `BRANCHES`.
        valid: (..., 8) bool, True where forward kinematics of ``q`` gives the pose, inside the limits if asked.
        singular: (..., 8) bool, True where th5 is 0 or pi, so that only th4 + th6 or th6 - th4 is determined.
    """

    q: Tensor
    valid: Tensor
    singular: Tensor

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.q, self.valid))


def puma560_ik(T: Tensor, *, limits: bool = True) -> Puma560Branches:
    """All eight joint vectors that bring the PUMA 560 to a pose, in closed form (see the module docstring).

    Whether a pose can be reached is the same for all eight branches. Where it cannot, ``q`` is the arm stretched
    (or folded) towards it, with a finite gradient, and ``valid`` is False. At a wrist singularity (sin th5 at most
    1e-10, in float32 2e-6) th4 is set to 0, the rest is still exact, and the branch is flagged; its flip has
    th4 = pi, which the limits exclude. Matrices that are no rigid transform (by more than 1e-4, or not finite) are
    not valid, and their ``q`` belongs to the identity.

    Args:
        T: (..., 4, 4) poses of the flange of ``load_robot("puma560")`` in its base [m].
        limits: bring each angle into the built-in limits by a whole turn where one does, and call valid only what is
            inside; False: angles from -pi to pi, and every reachable branch is valid.

    Returns:
        `Puma560Branches`: ``q`` (..., 8, 6) and ``valid`` (..., 8) on unpacking, and ``singular`` (..., 8).

    Raises:
        ShapeError: ``T`` is not (..., 4, 4) floating point.

    Source: Yildirim and Eski (2006), eqs. (2)-(31); branches named as by Lee and Ziegler (1984).
    Differences: standard frames; errata 5-18 of `docs/papers/puma-closed-form.md` corrected; sines and cosines
    algebraic; th6 from th4.

    Example:
        >>> import ikgrad as ik, torch
        >>> robot = ik.load_robot("puma560")
        >>> q = torch.tensor([0.3, -0.5, 2.5, 0.2, 0.8, -0.4], dtype=torch.float64)
        >>> branches, valid = ik.puma560_ik(ik.forward_kinematics(robot, q))
        >>> branches.shape, torch.allclose(branches[0], q)  # left, up, no flip
        (torch.Size([8, 6]), True)
    """
    check_poses("T", T)
    shape, flat = T.shape[:-2], T.reshape(-1, 16)
    bounds = _builtin_limits(T.dtype, T.device) if limits else None
    q, valid, singular = solve_branches(flat, bounds)
    return Puma560Branches(q.view(*shape, 8, 6), valid.view(*shape, 8), singular.view(*shape, 8))


def solve_branches(
    T: Tensor, bounds: tuple[Tensor, Tensor] | None = None, theta4: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """`puma560_ik` flat, by the compiled kernel for float64 on the CPU without gradients, else in torch.

    Args:
        T: (N, 16) poses.
        bounds: (6,) and (6,) limits, or None.
        theta4: (N,) what th4 is where the wrist is singular; default 0.

    Returns:
        (N, 8, 6) joints, (N, 8) valid, (N, 8) singular.
    """
    if _takes_kernel(T):
        from ikgrad.engine.puma560 import branches

        nowhere = torch.full((6,), math.inf, dtype=T.dtype)
        low, high = (-nowhere, nowhere) if bounds is None else bounds
        free = T.new_zeros(len(T)) if theta4 is None else theta4
        q, valid, singular = branches(
            T.detach().numpy(), free.numpy(), (A2, A3, D2, D4, Z0), low.numpy(), high.numpy(),
            tolerance=ROTATION_TOLERANCE, threads=torch.get_num_threads(),
        )  # fmt: skip
        return torch.from_numpy(q), torch.from_numpy(valid), torch.from_numpy(singular)
    return plain_branches(T, bounds, theta4)


def _takes_kernel(T: Tensor) -> bool:
    return (
        T.dtype == torch.float64
        and T.device.type == "cpu"
        and not (T.requires_grad and torch.is_grad_enabled())
        and not torch.compiler.is_compiling()
        and not torch._C._are_functorch_transforms_active()  # vmap, jacrev, ...
        and forward_ad._current_level < 0
    )


@functools.cache
def _builtin_limits(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    robot = load_robot("puma560")
    return robot.q_min.to(device, dtype), robot.q_max.to(device, dtype)


def plain_branches(
    flat: Tensor, bounds: tuple[Tensor, Tensor] | None, theta4: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """`solve_branches` in torch operations alone.

    Inside, a quantity is a tensor with the rows last: (N,), (2, N) by shoulder, or (2, 2, N) by shoulder and elbow.
    """
    T = flat.mT.contiguous()  # (16, N): every entry contiguous
    rigid = _is_rigid(T)
    identity = torch.eye(4, dtype=T.dtype, device=T.device).view(16, 1)
    T = torch.where(rigid, T, identity)
    s1, c1, rho, shoulder_ok = _shoulder(T[3], T[7])
    pz = T[11] - Z0
    s3, c3, elbow_ok = _elbow(rho, pz)
    up_down = torch.tensor([[0, 1], [1, 0]], device=T.device)  # place of W's sign by [left, right] x [up, down]
    theta1, theta3 = torch.atan2(s1, c1), torch.atan2(s3, c3)[up_down]  # few arctangents: first take, then share
    s3, c3 = s3[up_down], c3[up_down]
    s23, c23 = _forearm(rho[:, None], pz, s3, c3)
    theta2 = torch.atan2(s23 * c3 - c23 * s3, c23 * c3 + s23 * s3)
    t4, t5, t6, singular = _wrist(T, s1[:, None], c1[:, None], s23, c23, theta4)
    arm = (theta1[:, None].expand_as(theta2), theta2, theta3)
    unflipped, flipped = torch.stack([*arm, t4, t5, t6]), torch.stack([*arm, _half_turn(t4), -t5, _half_turn(t6)])
    q = torch.stack([unflipped, flipped], dim=3).reshape(6, 8, -1)
    valid = (rigid & shoulder_ok & elbow_ok).expand(8, -1)
    if bounds is not None:
        q, inside = _into_limits(q, *bounds)
        valid = valid & inside
    singular = singular[:, :, None].expand(2, 2, 2, -1).reshape(8, -1)
    return q.permute(2, 1, 0).contiguous(), valid.mT.contiguous(), singular.mT.contiguous()


def _shoulder(px: Tensor, py: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Sine and cosine of th1 (2, N), rho (2, N), and whether the wrist is outside of the shoulder's cylinder (N,)."""
    on_axis = px.square() + py.square() < 1e-12
    px, py = torch.where(on_axis, 0.0, px), torch.where(on_axis, 1e-6, py)
    root, ok = _safe_sqrt(px.square() + py.square() - D2**2)
    rho = torch.stack([root, -root])
    y, x = rho * py - D2 * px, rho * px + D2 * py
    norm = (x.square() + y.square()).sqrt()
    return y / norm, x / norm, rho, ok


def _elbow(rho: Tensor, pz: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sine and cosine of th3 (2, N), first for W > 0, then for W < 0; whether the wrist is in reach (N,)."""
    K = (rho[0].square() + pz.square() - A2**2 - L2) / (2 * A2)  # the same for both shoulders
    root, ok = _safe_sqrt(L2 - K.square())
    K = K.clamp(-math.sqrt(L2), math.sqrt(L2))
    W = torch.stack([root, -root])
    return (D4 * K + A3 * W) / L2, (A3 * K - D4 * W) / L2, ok


def _forearm(rho: Tensor, pz: Tensor, s3: Tensor, c3: Tensor) -> tuple[Tensor, Tensor]:
    """Sine and cosine of th23 from rho (2, 1, N) and those of th3 (2, 2, N)."""
    at_shoulder = rho.square() + pz.square() < 1e-12  # out of reach, and without a direction
    pz = torch.where(at_shoulder, 1.0, pz)
    A, B = A3 + A2 * c3, D4 + A2 * s3
    y, x = B * rho - A * pz, A * rho + B * pz
    norm = (x.square() + y.square()).sqrt()
    return y / norm, x / norm


def _wrist(
    T: Tensor, s1: Tensor, c1: Tensor, s23: Tensor, c23: Tensor, theta4: Tensor | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """th4, th5 >= 0, th6 and whether th4 was free to choose; (2, 2, N) from s1, c1 (2, 1, N) and s23, c23 (2, 2, N)."""
    x1, x2, x3 = (c1 * T[j] + s1 * T[4 + j] for j in range(3))  # Rz(-th1) R, first row
    M21, M22, M23 = (c1 * T[4 + j] - s1 * T[j] for j in range(3))  # and second, which Ry(-th23) leaves alone
    M11, M12, M13 = (c23 * x - s23 * z for x, z in ((x1, T[8]), (x2, T[9]), (x3, T[10])))
    M33 = s23 * x3 + c23 * T[10]
    square = M13.square() + M23.square()
    singular = square <= _SINGULAR[T.dtype] ** 2
    s5 = torch.where(singular, 1.0, square).sqrt()
    chosen = torch.zeros_like(T[0]) if theta4 is None else theta4
    s4 = torch.where(singular, chosen.sin(), M23 / s5)
    c4 = torch.where(singular, chosen.cos(), M13 / s5)
    t5 = torch.atan2(c4 * M13 + s4 * M23, M33)
    t6 = torch.atan2(c4 * M21 - s4 * M11, c4 * M22 - s4 * M12)
    return torch.atan2(s4, c4), t5, t6, singular


# What rounding leaves of a zero, some ten times over: of sin th5, of a square [m^2], of an angle at its limit [rad].
_SINGULAR = {torch.float64: 1e-10, torch.float32: 2e-6}
_SQUARE_SLACK = {torch.float64: 1e-12, torch.float32: 2e-6}
_LIMIT_SLACK = {torch.float64: 1e-10, torch.float32: 2e-6}


def _safe_sqrt(x: Tensor) -> tuple[Tensor, Tensor]:
    """Root of a square that rounding may have made negative, 0 below, with a finite gradient; and x >= 0 so far."""
    positive = x > 0
    root = torch.where(positive, torch.where(positive, x, 1.0).sqrt(), 0.0)
    return root, x >= -_SQUARE_SLACK[x.dtype]


def _half_turn(angle: Tensor) -> Tensor:
    """The opposite angle, from -pi to pi."""
    return torch.where(angle > 0, angle - math.pi, angle + math.pi)


def _is_rigid(T: Tensor) -> Tensor:
    """(N,) True where the columns of (16, N) matrices are orthonormal, the third is first x second, the last row 0001.

    NaN compares False.
    """
    a, b, c = ((T[j], T[4 + j], T[8 + j]) for j in range(3))
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    off = [a[0] ** 2 + a[1] ** 2 + a[2] ** 2 - 1, b[0] ** 2 + b[1] ** 2 + b[2] ** 2 - 1]
    off += [a[0] * b[0] + a[1] * b[1] + a[2] * b[2], *(x - y for x, y in zip(cross, c, strict=True))]
    off += [T[12], T[13], T[14], T[15] - 1]
    good = (T[3] + T[7] + T[11]).isfinite()
    for value in off:
        good = good & (value.abs() <= ROTATION_TOLERANCE)
    return good


def _into_limits(q: Tensor, q_min: Tensor, q_max: Tensor) -> tuple[Tensor, Tensor]:
    """(6, 8, N) angles from -pi to pi, by a whole turn inside the limits where that helps; (8, N) which are inside."""
    turn, slack = 2 * math.pi, _LIMIT_SLACK[q.dtype]
    q_min, q_max = q_min.view(6, 1, 1), q_max.view(6, 1, 1)
    low, high = q_min - slack, q_max + slack
    q = torch.where((q > high) & (q - turn >= low), q - turn, q)
    q = torch.where((q < low) & (q + turn <= high), q + turn, q)
    inside = (q >= low) & (q <= high)
    return torch.where(inside, q.clamp(q_min, q_max), q), inside.all(dim=0)
