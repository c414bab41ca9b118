"""Damped least squares with limits and restarts: the default method."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.solvers.base import State, check_positive
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.starts import random_configurations

CANDIDATES = 4  # random configurations that a start is chosen from


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Levenberg-Marquardt on the pose error, joints held at their limits, random restarts.

    With e = [(p* - p) / L; log(R* R^T)], L a length of the robot, and J its Jacobian,

        (J_f^T J_f + mu I) dq = J_f^T e,     mu = damping |e|^2 + 1e-12
        q <- clamp(q + clip(dq, -step_limit, +step_limit), q_min, q_max)

    The damping vanishes with the error (Yamashita and Fukushima 2001; Sugihara 2011), so the last steps are Newton's.
    J_f leaves out the joints that stand at a limit and whose gradient points outwards (an active set). A start is
    abandoned when the error has not fallen by 30 % in 3 steps after the fifth; the next one is the best, by error,
    of a few random configurations, which depend on the row and ``seed`` alone.

    On the CPU the whole method runs in compiled kernels (`ikgrad.engine`), several rows side by side. Starts come from
    a table of configurations near the target before random ones; a redundant arm that is given ``q0`` also uses its
    spare freedom to turn away from the limits, so that a followed path does not end in them. Elsewhere, or with
    ``compiled=False``, it is the torch code of this file. Both find the same share of solutions, not the same ones.

    Args:
        damping: factor of |e|^2 in mu.
        step_limit: largest change of a joint in one step [rad, or units of L for slides].
        max_starts: starts tried for a row before it fails.
        steps_per_start: evaluations allowed for one start.
        table: take starts from the table before random ones; False, to see what it is worth. Kernels only.
        compiled: use the kernels for CPU tensors.

    Raises:
        ConfigError: a setting is not positive.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> T = ik.forward_kinematics(robot, ik.sample_configurations(robot, 5, seed=1))
        >>> bool(ik.solve_ik(robot, T, solver=ik.LevenbergMarquardt()).success.all())
        True
    """

    damping: float = 0.05
    step_limit: float = 0.8
    max_starts: int = 300
    steps_per_start: int = 60
    table: bool = True
    compiled: bool = True

    restarts = True

    def __post_init__(self) -> None:
        check_positive(self, damping=self.damping, step_limit=self.step_limit)
        check_positive(self, max_starts=self.max_starts, steps_per_start=self.steps_per_start)

    @property
    def max_steps(self) -> int:
        """Evaluations allowed for a row in all."""
        return self.max_starts * self.steps_per_start

    def init(self, problem: Problem, q: Tensor) -> State:
        """Evaluate the starts."""
        q = q.clamp(problem.q_min, problem.q_max)
        start = torch.zeros_like(problem.key)
        return self._evaluate(problem, q, {"start": start, "age": start})

    def step(self, problem: Problem, state: State) -> State:
        """One damped step, or a new start for the rows whose present one has stalled."""
        memory = dict(state.memory)
        e, J = memory.pop("e"), memory.pop("J")
        g = (J.mT @ e[..., None])[..., 0]
        stuck = ((state.q <= problem.q_min) & (g < 0)) | ((state.q >= problem.q_max) & (g > 0))
        J = torch.where(stuck[:, None, :], 0.0, J)
        limit = torch.where(problem.robot.revolute, 1.0, problem.robot.length).to(e) * self.step_limit
        dq = _damped_step(J, e, self.damping).clamp(-limit, limit)
        q = (state.q + dq).clamp(problem.q_min, problem.q_max)
        stalled = torch.nonzero(self._stalled(memory, e) | ~q.isfinite().all(dim=-1)).flatten()
        memory = {name: value.clone() for name, value in memory.items()}
        memory["age"] += 1
        memory["start"][stalled] += 1
        memory["age"][stalled] = 0
        if len(stalled):
            q[stalled] = best_start(problem.rows(stalled), memory["start"][stalled])
        return self._evaluate(problem, q, memory)

    def _stalled(self, memory: dict[str, Tensor], e: Tensor) -> Tensor:
        """No 30 % fall of the error in 3 steps, after the fifth; or too many steps."""
        history = memory["history"]  # (B, 3) |e| one, two, three steps ago
        stalled = (memory["age"] > 5) & (e.norm(dim=-1) > 0.7 * history[:, 2])
        stalled |= memory["age"] + 1 >= self.steps_per_start
        memory["history"] = torch.cat([e.norm(dim=-1, keepdim=True), history[:, :2]], dim=1)
        return stalled

    def _evaluate(self, problem: Problem, q: Tensor, memory: dict[str, Tensor]) -> State:
        e, J = problem.linearise(q)
        position, rotation = e[..., :3].norm(dim=-1), e[..., 3:].norm(dim=-1)
        scale = torch.ones(6, dtype=e.dtype, device=e.device)
        scale[:3] /= problem.robot.length
        memory.setdefault("history", torch.full_like(e[:, :3], torch.inf))
        done = problem.met(position, rotation) | (memory["start"] >= self.max_starts)
        return State(q, position, rotation, done, {**memory, "e": e * scale, "J": J * scale[:, None]})


def best_start(problem: Problem, start: Tensor) -> Tensor:
    """The random configuration with the smallest pose error out of a few.

    Args:
        problem: B rows.
        start: (B,) number of the start.

    Returns:
        (B, n)
    """
    draw = start[:, None] * CANDIDATES + torch.arange(CANDIDATES, device=start.device)
    q = random_configurations(problem.robot, problem.key, draw)  # (B, c, n)
    every = torch.arange(len(start), device=start.device).repeat_interleave(CANDIDATES)
    position, rotation = problem.rows(every).measure(q.flatten(0, 1))
    merit = (position / problem.robot.length).square() + rotation.square()
    best = merit.view(-1, CANDIDATES).argmin(dim=1)
    return q[torch.arange(len(q), device=q.device), best].clamp(problem.q_min, problem.q_max)


def _damped_step(J: Tensor, e: Tensor, damping: float) -> Tensor:
    """(B, n) solution of the damped normal equations, in the smaller of their two equal forms.

    (J^T J + mu I)^-1 J^T e  =  J^T (J J^T + mu I)^-1 e
    """
    mu = damping * e.square().sum(dim=-1) + 1e-12
    wide = J.shape[-1] > J.shape[-2]
    A = J @ J.mT if wide else J.mT @ J
    A = A + mu[:, None, None] * torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
    right = e[..., None] if wide else J.mT @ e[..., None]
    factor, _ = torch.linalg.cholesky_ex(A)  # a failed row comes out as NaN and starts anew
    x = torch.cholesky_solve(right, factor)
    return (J.mT @ x if wide else x)[..., 0]
