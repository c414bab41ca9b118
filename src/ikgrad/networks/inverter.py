"""Neural inverters: a pose in, joint values out; or a pose and the present joints in, the next joints out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from ikgrad.errors import DataError, RobotError, ShapeError
from ikgrad.kinematics import check_poses, check_q
from ikgrad.networks.encodings import encode_pose, feature_names
from ikgrad.networks.mlp import MLP
from ikgrad.networks.scaling import MinMax
from ikgrad.robot import Robot
from ikgrad.rotations import nearest_rotation
from ikgrad.solvers.damped import damped_steps

_DAMPING = 1e-3  # of corrections: they begin near the answer, where undamped steps are the best
_CONSTANT = 1e-9  # [m, rad]: a feature or joint that varies less is rounding noise, which scaling must not blow up


class Inverter(nn.Module):
    r"""Inverse kinematics by a network: ``q = s_q^-1(MLP(s_x([features(T), q_current])))``.

    Features and joint values are scaled to [-1, 1] by their ranges in the training data; the ranges and the reference
    pose are buffers of the model, set by `fit`, so that a user gives metres and gets radians. A network of this
    kind answers where it was trained, and nowhere else.

    Args:
        robot: the robot, n joint variables.
        feedback: also look at the present joints; then the second argument of a call is needed.
        hidden: units of each hidden layer.
        activation: of the hidden layers.
        encoding: form of the rotation, see `ikgrad.networks.encodings`.
        reference: (4, 4) pose that the features are relative to; default: `fit` takes the mean of its poses.
        bounded: the answer never leaves the joint limits: a tanh at the output, scaled to the limits instead of to
            the range of the data.
        seed: of the first weights.
        dtype: of weights and buffers; poses and joints of another dtype are refused.

    Raises:
        RobotError: ``bounded`` and the robot has a joint without limits.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("denso_vp6242")
        >>> q = ik.sample_configurations(robot, 50, seed=0)
        >>> T = ik.forward_kinematics(robot, q)
        >>> inverter = ik.Inverter(robot, feedback=True, hidden=(20,)).fit(T, q, q + 0.01)
        >>> inverter(T, q).shape, inverter(T[0], q[0]).shape
        (torch.Size([50, 6]), torch.Size([6]))
    """

    reference: Tensor

    def __init__(
        self,
        robot: Robot,
        *,
        feedback: bool = False,
        hidden: Sequence[int] = (10,),
        activation: str = "tanh",
        encoding: str = "rotation_vector",
        reference: Tensor | None = None,
        bounded: bool = False,
        seed: int = 0,
        dtype: torch.dtype = torch.float64,
    ):
        super().__init__()
        self.robot, self.feedback, self.encoding, self.bounded = robot, feedback, encoding, bounded
        inputs = len(self.feature_names)
        output = "tanh" if bounded else "linear"
        self.network = MLP((inputs, *hidden, robot.dof), hidden=activation, output=output, seeds=seed, dtype=dtype)
        self.input_scale = MinMax(inputs, low=-1.0, high=1.0, dtype=dtype)
        self.output_scale = MinMax(robot.dof, low=-1.0, high=1.0, dtype=dtype)
        self._find_reference = reference is None
        given = torch.eye(4, dtype=dtype) if reference is None else reference.to(dtype).clone()
        check_poses("reference", given)
        self.register_buffer("reference", given)
        if bounded:
            self._scale_to_limits()

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the inputs, with units, in order."""
        present = [f"current {name}" for name in self.robot.joint_names] if self.feedback else []
        return (*feature_names(self.encoding), *present)

    @torch.no_grad()
    def fit(self, T: Tensor, q: Tensor, q_current: Tensor | None = None) -> Inverter:
        """Take reference and scaling from training data; the weights stay as they are. Returns itself.

        A column that varies by less than 1e-9 counts as constant and is not looked at.

        Args:
            T: (..., 4, 4) poses [m].
            q: (..., n) joint values of these poses.
            q_current: (..., n) present joints, for a feedback inverter.

        Raises:
            ShapeError: shapes or dtypes do not fit.
            DataError: no rows, or a value that is not finite.
        """
        self._check(T, q_current)
        check_q(self.robot, q)
        _check_data(T, q, q_current)
        if self._find_reference:
            self.reference.copy_(_mean_pose(T.reshape(-1, 4, 4)))
        _fit_scale(self.input_scale, self.features(T, q_current))
        if not self.bounded:
            _fit_scale(self.output_scale, q)
        return self

    def forward(self, T: Tensor, q_current: Tensor | None = None) -> Tensor:
        """Joint values for poses.

        Args:
            T: (..., 4, 4) wanted poses [m].
            q_current: (..., n) present joints, for a feedback inverter; broadcasts against ``T``.

        Returns:
            (..., n) joint values [rad or m].

        Raises:
            ShapeError: shapes or dtypes do not fit, or ``q_current`` is missing or too much.
        """
        return self.answer(self.features(T, q_current))

    def features(self, T: Tensor, q_current: Tensor | None = None) -> Tensor:
        """(..., k) what the network looks at, in SI units, in the order of ``feature_names``."""
        self._check(T, q_current)
        pose = encode_pose(T, self.reference, encoding=self.encoding)
        if q_current is None:
            return pose
        lead = torch.broadcast_shapes(pose.shape[:-1], q_current.shape[:-1])
        return torch.cat([pose.expand(*lead, -1), q_current.expand(*lead, -1)], dim=-1)

    def answer(self, features: Tensor) -> Tensor:
        """(..., n) joint values for `features`."""
        q = self.output_scale.inverse(self.network(self.input_scale(features)))
        if self.bounded:  # rounding may pass the limit by the last digit
            q = torch.minimum(torch.maximum(q, self.robot.q_min.to(q)), self.robot.q_max.to(q))
        return q

    def rollout(self, T: Tensor, q_start: Tensor, *, corrections: int = 0) -> Tensor:
        """Follow a path in closed loop: the answer for one pose is the present joints for the next.

        Args:
            T: (N, 4, 4) poses along the path.
            q_start: (n,) or (..., n) joints before the first pose.
            corrections: damped least-squares steps through FK after every answer, before it is given and fed back, see
                `ikgrad.solvers.damped`; inside the joint limits, and without a gradient.

        Returns:
            (N, n) or (N, ..., n) answers. A traditional inverter does not look at the present joints, so that these
            are its answers one by one.

        Example:
            >>> import ikgrad as ik
            >>> robot = ik.load_robot("ur5e")
            >>> q = ik.sample_configurations(robot, 9, seed=0)
            >>> T = ik.forward_kinematics(robot, q)
            >>> inverter = ik.Inverter(robot, feedback=True).fit(T, q, q)
            >>> with torch.no_grad():
            ...     path = inverter.rollout(T, q[0])
            >>> torch.allclose(path[1], inverter(T[1], path[0]))
            True
        """
        check_q(self.robot, q_start, "q_start")
        if not self.feedback:
            q = self._corrected(T, self(T), corrections)
            lead = q_start.shape[:-1]
            return q.reshape(len(q), *[1] * len(lead), -1).expand(-1, *lead, -1)
        pose = encode_pose(
            T, self.reference, encoding=self.encoding
        )  # all at once; only the joints wait for each other
        q, answers = q_start, []
        for row, target in zip(pose, T, strict=True):
            q = self.answer(torch.cat([row.expand(*q.shape[:-1], -1), q], dim=-1))
            q = self._corrected(target, q, corrections)
            answers.append(q)
        return torch.stack(answers)

    def _corrected(self, T: Tensor, q: Tensor, steps: int) -> Tensor:
        return damped_steps(self.robot, T, q, steps=steps, damping=_DAMPING).q if steps else q

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write ``model.safetensors`` and ``config.json`` into a new folder, see `ikgrad.networks.storage`."""
        from ikgrad.networks.storage import save_inverter

        return save_inverter(self, folder, force=force)

    @property
    def dtype(self) -> torch.dtype:
        """Of weights and buffers."""
        return self.reference.dtype

    def extra_repr(self) -> str:
        """Kind and robot, for ``print(inverter)``."""
        kind = "feedback" if self.feedback else "traditional"
        return f"{kind}, {self.robot.name!r}, encoding={self.encoding}, bounded={self.bounded}"

    def _scale_to_limits(self) -> None:
        low, high = (limit.to(self.dtype) for limit in (self.robot.q_min, self.robot.q_max))
        if not (low.isfinite() & high.isfinite()).all():
            free = [v.name for v in self.robot.variables if not (abs(v.q_min) < torch.inf and abs(v.q_max) < torch.inf)]
            raise RobotError(f"robot '{self.robot.name}': bounded needs limits, but {', '.join(free)} has none")
        self.output_scale.minimum.copy_(low)
        self.output_scale.span.copy_(high - low)

    def _check(self, T: Tensor, q_current: Tensor | None) -> None:
        check_poses("T", T)
        if self.feedback and q_current is None:
            raise ShapeError("this is a feedback inverter: give the present joints, inverter(T, q_current)")
        if q_current is not None:
            if not self.feedback:
                raise ShapeError("this inverter does not look at the present joints; leave q_current out")
            check_q(self.robot, q_current, "q_current")
        for name, value in (("T", T), ("q_current", q_current)):
            if value is not None and value.dtype != self.dtype:
                raise ShapeError(
                    f"{name} must be {self.dtype} like the inverter, got {value.dtype}; "
                    f"use {name}.to({self.dtype}) or inverter.to({value.dtype})"
                )


def _check_data(T: Tensor, q: Tensor, q_current: Tensor | None) -> None:
    if T.shape[:-2] != q.shape[:-1]:
        raise ShapeError(f"T and q must have the same rows, got {tuple(T.shape)} and {tuple(q.shape)}")
    if T.numel() == 0:
        raise DataError("the data set is empty; there is nothing to learn from")
    for name, data in (("T", T), ("q", q), ("q_current", q_current)):
        if data is not None and not data.isfinite().all():
            place = (~data.isfinite()).nonzero()[0].tolist()
            raise DataError(f"{name}{place} is {data[tuple(place)].item()}; the data must be finite")


def _mean_pose(T: Tensor) -> Tensor:
    """Mean position, and the rotation closest to the mean matrix."""
    mean = T.mean(0)
    mean[:3, :3] = nearest_rotation(mean[:3, :3])
    return mean


def _fit_scale(scale: MinMax, data: Tensor) -> None:
    scale.fit(data)
    scale.span[scale.span < _CONSTANT] = 0.0


__all__ = ["Inverter"]
