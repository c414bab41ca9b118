"""Forward kinematics, Jacobian and pose error: any batch shape, device and dtype, differentiable twice.

Float64 tensors on the CPU go through the compiled kernels of `ikgrad.engine`; everything else (CUDA, float32, second
derivatives, ``vmap``, ``torch.compile``) takes the plain torch path below, which is also what the kernels are tested
against.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import forward_ad

from ikgrad.errors import ShapeError
from ikgrad.robot import Robot
from ikgrad.rotations import log_rotation
from ikgrad.segments import Tables


def forward_kinematics(robot: Robot, q: Tensor) -> Tensor:
    """Pose of the tip in the base: the product of the segment matrices, T = A_1(q) ... A_m(q) T_tool.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) joint values [rad or m].

    Returns:
        (..., 4, 4) poses, of the dtype and on the device of ``q``.

    Raises:
        ShapeError: ``q`` does not end in n floating-point values.

    Example:
        >>> import ikgrad as ik, torch
        >>> robot = ik.load_robot("kr210")
        >>> ik.forward_kinematics(robot, torch.zeros(6, dtype=torch.float64))[0, 3]
        tensor(1.5410, dtype=torch.float64)
    """
    check_q(robot, q)
    if takes_kernels(robot, q):
        from ikgrad.engine.autograd import forward_kinematics as compiled

        return compiled(robot, q)
    return plain_forward_kinematics(robot, q)


def link_poses(robot: Robot, q: Tensor) -> Tensor:
    """Poses of all links on the chain in the base, in the order of ``robot.link_names``.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) joint values [rad or m].

    Returns:
        (..., links, 4, 4) poses; the first is the base (identity), the last the tip.

    Example:
        >>> import ikgrad as ik, torch
        >>> robot = ik.load_robot("ur5e")
        >>> ik.link_poses(robot, torch.zeros(3, 6)).shape
        torch.Size([3, 8, 4, 4])
    """
    check_q(robot, q)
    tables = robot.tables(dtype=q.dtype, device=q.device)
    base = torch.eye(4, dtype=q.dtype, device=q.device).expand(*q.shape[:-1], 4, 4)
    frames = torch.stack([base, *_moving_frames(tables, q)], dim=-3)  # (..., m + 1, 4, 4)
    return frames[..., tables.link_frame, :, :] @ tables.link_offset


def jacobian(robot: Robot, q: Tensor) -> Tensor:
    """Geometric Jacobian in the base frame, [linear; angular]: tip twist = J qd.

    Column of a turning joint with axis z through p_k: [z x (p - p_k); z]; of a sliding one: [z; 0]. A mimic joint
    adds ``multiplier`` times its column to that of the joint it follows.

    Args:
        robot: the robot, n joint variables.
        q: (..., n) joint values [rad or m].

    Returns:
        (..., 6, n)

    Example:
        >>> import ikgrad as ik, torch
        >>> ik.jacobian(ik.load_robot("panda"), torch.zeros(2, 5, 7)).shape
        torch.Size([2, 5, 6, 7])
    """
    check_q(robot, q)
    if takes_kernels(robot, q) and not (q.requires_grad and torch.is_grad_enabled()):
        from ikgrad.engine.autograd import jacobian as compiled

        return compiled(robot, q)
    return pose_and_jacobian(robot, q)[1]


def takes_kernels(robot: Robot, q: Tensor) -> bool:
    """True if the compiled kernels can serve: float64 on the CPU, and no transform that must see torch operations."""
    return q.dtype == torch.float64 and q.device.type == "cpu" and robot.geometry is None and no_transform()


def no_transform() -> bool:
    """True unless a transform (``vmap``, ``jvp``, ``torch.compile``) runs, which must see torch operations alone."""
    return (
        not torch.compiler.is_compiling()
        and not torch._C._are_functorch_transforms_active()  # vmap, jacrev, ...
        and forward_ad._current_level < 0
    )


def plain_forward_kinematics(robot: Robot, q: Tensor) -> Tensor:
    """`forward_kinematics` in torch operations alone."""
    tables = robot.tables(dtype=q.dtype, device=q.device)
    return _moving_frames(tables, q)[-1] @ tables.tool


def pose_and_jacobian(robot: Robot, q: Tensor) -> tuple[Tensor, Tensor]:
    """`forward_kinematics` and `jacobian` in one pass, for code that needs both."""
    tables = robot.tables(dtype=q.dtype, device=q.device)
    frames = _moving_frames(tables, q)
    T = frames[-1] @ tables.tool
    moving = torch.stack(frames, dim=-3)  # (..., m, 4, 4)
    z = (moving[..., :3, :3] @ tables.axes[..., None])[..., 0]  # (..., m, 3)
    lever = T[..., None, :3, 3] - moving[..., :3, 3]
    slides = tables.prismatic[:, None]
    linear = torch.where(slides, z, torch.linalg.cross(z, lever))
    angular = torch.where(slides, torch.zeros_like(z), z)
    columns = torch.cat([linear, angular], dim=-1) * tables.multiplier[:, None]  # (..., m, 6)
    if len(tables.variable) == robot.dof:  # no mimic joints: each column is its own variable's
        return T, columns.mT
    J = torch.zeros(*q.shape[:-1], robot.dof, 6, dtype=q.dtype, device=q.device)
    return T, J.index_add(-2, tables.variable, columns).mT


def pose_error(T: Tensor, T_target: Tensor) -> Tensor:
    """Position and rotation still missing to reach the target, in the base frame.

    ``[p* - p; log(R* R^T)]``, zero exactly at the target; the rotation part has norm at most pi.

    Args:
        T: (..., 4, 4) current pose [m].
        T_target: (..., 4, 4) wanted pose [m]; broadcasts against ``T``.

    Returns:
        (..., 6) error, first position [m], then rotation vector [rad].

    Raises:
        ShapeError: the last two dimensions are not (4, 4).

    Example:
        >>> import ikgrad as ik, torch
        >>> ik.pose_error(torch.eye(4), torch.eye(4))
        tensor([0., 0., 0., 0., 0., 0.])
    """
    for name, value in (("T", T), ("T_target", T_target)):
        check_poses(name, value)
    position = T_target[..., :3, 3] - T[..., :3, 3]
    rotation = log_rotation(T_target[..., :3, :3] @ T[..., :3, :3].mT)
    return torch.cat(torch.broadcast_tensors(position, rotation), dim=-1)


def check_q(robot: Robot, q: Tensor, name: str = "q") -> None:
    """Refuse a joint tensor of the wrong shape or dtype."""
    if not isinstance(q, Tensor) or not q.is_floating_point():
        got = q.dtype if isinstance(q, Tensor) else type(q).__name__
        raise ShapeError(f"{name} must be a floating-point tensor, got {got}")
    if q.ndim == 0 or q.shape[-1] != robot.dof:
        shape = tuple(q.shape)
        raise ShapeError(f"{name} must have shape (..., {robot.dof}) for robot '{robot.name}', got {shape}")


def check_poses(name: str, T: Tensor) -> None:
    """Refuse a pose tensor of the wrong shape or dtype."""
    if not isinstance(T, Tensor) or not T.is_floating_point():
        got = T.dtype if isinstance(T, Tensor) else type(T).__name__
        raise ShapeError(f"{name} must be a floating-point tensor, got {got}")
    if T.shape[-2:] != (4, 4):
        raise ShapeError(f"{name} must have shape (..., 4, 4), got {tuple(T.shape)}")


def _moving_frames(tables: Tables, q: Tensor) -> list[Tensor]:
    """Poses of the moving frames in the base after their motion: m tensors (..., 4, 4)."""
    angle = tables.multiplier * q[..., tables.variable] + tables.offset  # (..., m)
    local = tables.origins @ _motions(tables, angle)  # (..., m, 4, 4)
    frames = [local[..., 0, :, :]]
    for k in range(1, local.shape[-3]):
        frames.append(frames[-1] @ local[..., k, :, :])
    return frames


def _motions(tables: Tables, angle: Tensor) -> Tensor:
    """Rodrigues' formula I + sin K + (1 - cos) K^2, or a translation along the axis: (..., m, 4, 4)."""
    x, y, z = tables.axes.unbind(-1)
    o = torch.zeros_like(x)
    K = torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3))
    turn = torch.where(tables.prismatic, torch.zeros_like(angle), angle)[..., None, None]
    slide = torch.where(tables.prismatic, angle, torch.zeros_like(angle))[..., None]
    eye = torch.eye(3, dtype=K.dtype, device=K.device)
    R = eye + turn.sin() * K + (1 - turn.cos()) * (K @ K)
    top = torch.cat([R, (slide * tables.axes)[..., None]], dim=-1)
    bottom = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=K.dtype, device=K.device).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)
