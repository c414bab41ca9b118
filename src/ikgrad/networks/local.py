"""Inverters that start from the present joints: one increment, or a few rounds that hold the chain's own kinematics.

Both answer ``(T, q_current) -> q`` and take any batch shape. The network is float32, the chain float64. What the
networks see does not depend on where the base stands or how large the arm is: errors are seen from the tip, positions
count divided by the arm's typical length, turning joints come as sine and cosine, and limited ones also by their place
between the limits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.kinematics import check_poses, check_q, no_transform
from ikgrad.networks.residual import ResidualMLP
from ikgrad.robot import Robot
from ikgrad.solvers.damped import DAMPING, Damped, damped_steps, typical_length

_LEAST = 1e-9  # of an error that something is divided by
_FLOOR = 1e-4  # below it the logarithm of the error says nothing new
_BLOCK = 4096  # rows; hidden layers of 160 units take 2.6 MB then
_SOFT = 0.05  # a step is shown divided by error + this, so that it neither explodes nor vanishes


class IncrementInverter(nn.Module):
    r"""A plain network: ``q = clamp(q_current + N(e, q_current))`` in one go.

    e is the pose that is missing as the tip sees it, ``[R^T (p* - p) / length; R^T log(R* R^T)]``. The network holds
    no kinematics but the pose of ``q_current``.

    Args:
        robot: the robot, n joint variables.
        width: units of each hidden layer.
        depth: hidden layers.
        activation: of the hidden layers.
        seed: of the first weights.

    Raises:
        ShapeError: a size below one.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T, _, q_current = ik.data.TaskStream(robot, batch_size=6).batch(0)
        >>> IncrementInverter(robot)(T, q_current).shape
        torch.Size([6, 7])
    """

    family: ClassVar[str] = "increment"
    feedback: ClassVar[bool] = True  # it looks at the present joints
    middle: Tensor
    span: Tensor
    unit: Tensor

    def __init__(self, robot: Robot, *, width: int = 160, depth: int = 4, activation: str = "gelu", seed: int = 0):
        super().__init__()
        self.robot = robot
        limited = robot.q_min.isfinite() & robot.q_max.isfinite()
        low, high = (limit.to("cpu", torch.float64) for limit in (robot.q_min, robot.q_max))
        slides = ~robot.revolute
        self._turns = robot.revolute.cpu().nonzero()[:, 0]
        self._seen = (limited | slides).cpu().nonzero()[:, 0]
        zero, one = torch.zeros_like(low), torch.ones_like(low)
        self.register_buffer("middle", torch.where(limited, (low + high) / 2, zero), persistent=False)
        self.register_buffer("span", torch.where(limited, (high - low) / 2, one).clamp(min=1e-6), persistent=False)
        unit = one.masked_fill(slides.cpu(), typical_length(robot))  # of a joint's change, as the network says it
        self.register_buffer("unit", unit, persistent=False)
        inputs, outputs = self._sizes(2 * len(self._turns) + len(self._seen))
        self.network = ResidualMLP(inputs, outputs, width=width, depth=depth, activation=activation, seed=seed)

    def forward(self, T: Tensor, q_current: Tensor) -> Tensor:
        """Joint values for poses.

        Args:
            T: (..., 4, 4) wanted poses [m].
            q_current: (..., n) present joints; broadcasts against ``T``.

        Returns:
            (..., n) joint values inside the limits [rad or m], of the dtype of ``T``.

        Raises:
            ShapeError: shapes or dtypes do not fit.
        """
        check_poses("T", T)
        check_q(self.robot, q_current, "q_current")
        try:
            lead = torch.broadcast_shapes(T.shape[:-2], q_current.shape[:-1])
        except RuntimeError as error:
            raise ShapeError(
                f"T of shape {tuple(T.shape)} and q_current of shape {tuple(q_current.shape)} do not fit together"
            ) from error
        rows = T.expand(*lead, 4, 4).reshape(-1, 4, 4).double()
        start = q_current.expand(*lead, -1).reshape(-1, self.robot.dof).double()
        q = self._last(rows, start)
        q = torch.minimum(torch.maximum(q, self.robot.q_min.to(q)), self.robot.q_max.to(q))
        return q.reshape(*lead, self.robot.dof).to(T.dtype)

    def iterates(self, T: Tensor, q_current: Tensor) -> list[Tensor]:
        """The answer of every round, not yet clamped to the limits: what a training judges.

        Args:
            T: (B, 4, 4) wanted poses, float64.
            q_current: (B, n) present joints, float64.

        Returns:
            (B, n) tensors, one a round.
        """
        seen = damped_steps(self.robot, T, q_current)
        says = self.network(torch.cat([seen.error.float(), self._joints(seen.q)], dim=-1))
        return [seen.q + says.double() * self.unit]

    def _last(self, T: Tensor, q_current: Tensor) -> Tensor:
        """The last of `iterates`; block by block if there is no graph to keep, so that all of it stays in the cache."""
        if torch.is_grad_enabled() or not no_transform():
            return self.iterates(T, q_current)[-1]
        blocks = zip(T.split(_BLOCK), q_current.split(_BLOCK), strict=True)
        return torch.cat([self.iterates(*block)[-1] for block in blocks])

    def settings(self) -> dict[str, Any]:
        """Arguments that make an inverter of this shape again, without robot and seed."""
        return {name: getattr(self.network, name) for name in ("width", "depth", "activation")}

    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write ``model.safetensors`` and ``config.json`` into a new folder, see `ikgrad.networks.storage`."""
        from ikgrad.networks.storage import save_inverter

        return save_inverter(self, folder, force=force)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return (*_ERROR_NAMES, *self._joint_names())

    def extra_repr(self) -> str:
        """Robot, for ``print(inverter)``."""
        return repr(self.robot.name)

    def _sizes(self, joints: int) -> tuple[int, int]:
        return 6 + joints, self.robot.dof

    def _joints(self, q: Tensor) -> Tensor:
        """Sine and cosine of turning joints, then the place of limited joints and slides; float32."""
        turns = q[:, self._turns]
        place = ((q - self.middle) / self.span)[:, self._seen]
        return torch.cat([turns.sin(), turns.cos(), place], dim=-1).float()

    def _joint_names(self) -> tuple[str, ...]:
        names = self.robot.joint_names
        turns, seen = ([names[k] for k in columns.tolist()] for columns in (self._turns, self._seen))
        return (*[f"sin {n}" for n in turns], *[f"cos {n}" for n in turns], *[f"place of {n}" for n in seen])


class UnrolledInverter(IncrementInverter):
    r"""A few rounds, each a damped step of the chain's own Jacobian and a network that corrects it.

    With the error e_i and the damped step d_i (see `ikgrad.solvers.damped`) of the joints q_i, and one network for all
    rounds,

        (a_i, u_i) = N(e_i / |e_i|, d_i / (|e_i| + 0.05), log |e_i|, q_i)
        q_{i+1} = clamp(q_i + (1 + a_i) d_i + |e_i| u_i)

    A correction in proportion to the error vanishes with it, so that the rounds converge as the steps do. Error and
    step are features: no gradient flows through the chain, and every round learns from its own answer.

    Args:
        robot: the robot, n joint variables.
        rounds: how many; every one costs an evaluation of the chain.
        damping: of the steps.
        width: units of each hidden layer.
        depth: hidden layers.
        activation: of the hidden layers.
        seed: of the first weights.

    Raises:
        ShapeError: a size below one.
        ConfigError: ``damping`` is not positive, or there is no round.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T, _, q_current = ik.data.TaskStream(robot, batch_size=6).batch(0)
        >>> [tuple(q.shape) for q in UnrolledInverter(robot).iterates(T, q_current)]
        [(6, 7), (6, 7), (6, 7), (6, 7)]
    """

    family: ClassVar[str] = "unrolled"

    def __init__(
        self,
        robot: Robot,
        *,
        rounds: int = 4,
        damping: float = DAMPING,
        width: int = 128,
        depth: int = 2,
        activation: str = "gelu",
        seed: int = 0,
    ):
        if rounds < 1:
            raise ConfigError(f"rounds must be at least 1, got {rounds}")
        if not damping > 0:
            raise ConfigError(f"damping must be positive, got {damping}")
        super().__init__(robot, width=width, depth=depth, activation=activation, seed=seed)
        self.rounds, self.damping = rounds, damping

    def iterates(self, T: Tensor, q_current: Tensor) -> list[Tensor]:
        """The answer of every round, not yet clamped to the limits; see `IncrementInverter.iterates`."""
        answers, q = [], q_current
        for _ in range(self.rounds):
            seen = damped_steps(self.robot, T, q, damping=self.damping)
            answers.append(self._correct(seen))
            q = answers[-1]
        return answers

    def settings(self) -> dict[str, Any]:
        """Arguments that make an inverter of this shape again, without robot and seed."""
        return {"rounds": self.rounds, "damping": self.damping, **super().settings()}

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        steps = [f"step of {name}" for name in self.robot.joint_names]
        return (*_ERROR_NAMES, *steps, "log of the error", *self._joint_names())

    def extra_repr(self) -> str:
        """Robot and rounds, for ``print(inverter)``."""
        return f"{self.robot.name!r}, rounds={self.rounds}, damping={self.damping}"

    def _sizes(self, joints: int) -> tuple[int, int]:
        return 6 + self.robot.dof + 1 + joints, 2 * self.robot.dof

    def _correct(self, seen: Damped) -> Tensor:
        size = seen.error.norm(dim=-1, keepdim=True)
        step = seen.step / self.unit
        shown = torch.cat([seen.error / (size + _LEAST), step / (size + _SOFT), (size + _FLOOR).log()], dim=-1)
        stretch, more = self.network(torch.cat([shown.float(), self._joints(seen.q)], dim=-1)).double().chunk(2, dim=-1)
        return seen.q + ((1.0 + stretch) * step + size * more) * self.unit


_ERROR_NAMES = ("x", "y", "z", "rx", "ry", "rz")
FAMILIES = {cls.family: cls for cls in (IncrementInverter, UnrolledInverter)}

__all__ = ["FAMILIES", "IncrementInverter", "UnrolledInverter"]
