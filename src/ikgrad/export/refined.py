"""An inverter with damped steps and a check behind it, in torch operations that every exporter knows."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ikgrad.kinematics import pose_and_jacobian
from ikgrad.networks import Inverter

DAMPING, STEP_LIMIT = 0.05, 0.8  # those of `ikgrad.solvers.levenberg.LevenbergMarquardt`


class Refined(nn.Module):
    r"""An inverter's answer, improved by k damped steps and measured by forward kinematics.

    A step is that of `ik.LevenbergMarquardt`, joints at a limit with an outward gradient left out of J:

        dq = J^T (J J^T + mu I)^-1 e,   mu = 0.05 |e|^2 + 1e-12,   q <- clamp(q + clip(dq, -0.8, 0.8))

    with lengths divided by the robot's typical length and the rotation in e as ``2 sin(theta / 2)`` about its axis,
    which is the rotation vector to second order and needs no arc functions. Steps and check are done in float64,
    whatever the dtype of the network. There are no restarts: what does not converge is told by the errors.

    Args:
        inverter: the network; its robot is the one whose kinematics are used.
        steps: k, at least 0.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> q = ik.sample_configurations(robot, 20, seed=0)
        >>> T = ik.forward_kinematics(robot, q)
        >>> inverter = ik.Inverter(robot, feedback=True).fit(T, q, q)
        >>> refined = Refined(inverter, steps=2)
        >>> answer, position_error, rotation_error = refined(T, q)
        >>> answer.shape, position_error.shape
        (torch.Size([20, 6]), torch.Size([20]))
    """

    def __init__(self, inverter: Inverter, *, steps: int):
        super().__init__()
        self.inverter, self.steps = inverter, steps
        robot = inverter.robot.detach()
        self.robot = robot
        limit = torch.where(robot.revolute, STEP_LIMIT, STEP_LIMIT * robot.length).to(torch.float64)
        scale = torch.ones(6, dtype=torch.float64)
        scale[:3] /= robot.length
        for name, value in (("limit", limit), ("scale", scale), ("low", robot.q_min), ("high", robot.q_max)):
            self.register_buffer(name, value.to(torch.float64).clone(), persistent=False)

    limit: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor

    def forward(self, T: Tensor, q_current: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Improved joints and what is still missing.

        Args:
            T: (..., 4, 4) wanted poses [m].
            q_current: (..., n) present joints, for a feedback inverter.

        Returns:
            (..., n) joints, of the dtype of ``T``; (...) position error [m]; (...) rotation error [rad].
        """
        q = (self.inverter(T) if q_current is None else self.inverter(T, q_current)).double()
        q = torch.minimum(torch.maximum(q, self.low), self.high)
        goal = T.double()
        for _ in range(self.steps):
            q = self._step(q, goal)
        T_q, _ = pose_and_jacobian(self.robot, q)
        e, trace = _missing(T_q, goal)
        position = e[..., :3].square().sum(dim=-1).sqrt()
        sine, cosine = 0.5 * (3.0 - trace).clamp(min=0.0).sqrt(), 0.5 * (1.0 + trace).clamp(min=0.0).sqrt()
        sine = torch.where(trace > 0.0, 0.5 * e[..., 3:].square().sum(dim=-1).sqrt(), sine)  # of half the angle
        angle = 2.0 * torch.atan2(sine.float(), cosine.float())  # engines have arc functions in float32 alone
        return q.to(T.dtype), position.to(T.dtype), angle.to(T.dtype)

    def _step(self, q: Tensor, goal: Tensor) -> Tensor:
        T, J = pose_and_jacobian(self.robot, q)
        e, J = _missing(T, goal)[0] * self.scale, J * self.scale[:, None]
        g = (J.mT @ e[..., None])[..., 0]
        stuck = ((q <= self.low) & (g < 0)) | ((q >= self.high) & (g > 0))
        J = torch.where(stuck[..., None, :], torch.zeros_like(J), J)
        mu = DAMPING * e.square().sum(dim=-1) + 1e-12
        A = J @ J.mT + mu[..., None, None] * torch.eye(6, dtype=q.dtype)
        dq = (J.mT @ solve_spd(A, e)[..., None])[..., 0]
        dq = torch.minimum(torch.maximum(dq, -self.limit), self.limit)
        return torch.minimum(torch.maximum(q + dq, self.low), self.high)


def _missing(T: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """(..., 6) position error and 2 sin(theta / 2) times the axis of the rotation error; (...) trace of its matrix.

    Within a milliradian of half a turn the rotation part loses its length, at half a turn its axis.
    """
    E = goal[..., :3, :3] @ T[..., :3, :3].mT
    skew = torch.stack([E[..., 2, 1] - E[..., 1, 2], E[..., 0, 2] - E[..., 2, 0], E[..., 1, 0] - E[..., 0, 1]], dim=-1)
    trace = E[..., 0, 0] + E[..., 1, 1] + E[..., 2, 2]
    rotation = skew / (1.0 + trace).clamp(min=1e-6).sqrt()[..., None]  # sqrt(1 + tr) = 2 cos(theta / 2)
    return torch.cat([goal[..., :3, 3] - T[..., :3, 3], rotation], dim=-1), trace


def solve_spd(A: Tensor, b: Tensor) -> Tensor:
    """Solution of ``A x = b`` for a symmetric positive definite A, by Gauss-Jordan elimination without pivots.

    Exchange formats have no Cholesky factor; products and quotients they all have. Pivots of such a matrix are never
    zero, and none is exchanged, so the graph is a straight line.

    Args:
        A: (..., k, k)
        b: (..., k)

    Returns:
        (..., k)

    Example:
        >>> import torch
        >>> solve_spd(torch.tensor([[4.0, 2.0], [2.0, 3.0]]), torch.tensor([8.0, 8.0]))
        tensor([1., 2.])
    """
    k = A.shape[-1]
    M = torch.cat([A, b[..., None]], dim=-1)
    unit = torch.eye(k, dtype=A.dtype, device=A.device)
    for j in range(k):
        row = M[..., j : j + 1, :] / M[..., j : j + 1, j : j + 1]
        M = M - (M[..., :, j : j + 1] - unit[:, j : j + 1]) * row
    return M[..., k]


__all__ = ["Refined", "solve_spd"]
