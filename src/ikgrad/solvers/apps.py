"""APPS: gradient descent on the pose error (Yuan, Su, Shi, Wang, Chen 2015), the gradient by autograd."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.solvers.base import State, check_positive
from ikgrad.solvers.problem import Problem


@dataclass(frozen=True)
class Apps:
    """Gradient descent on the sum of squares of all pose entries, with a limited step.

    Per row, with e_ij = (T* - T(q))_ij over the nine rotation entries and three coordinates [m] (eqs. 8-10):

        E = sum e_ij^2,   or half of it with ``half_sum`` (eq. 11)
        dq_k = -eta dE/dq_k                                  (eq. 13)
        q_k <- q_k + clip(dq_k, -step_limit, +step_limit)    (eq. 20, corrected)

    until E <= E0. dE/dq comes from autograd through the pytorch-kinematics chain; it equals -2 J^T e of the pose
    entries. An iteration is one evaluation of E, the successful one included. Afterwards `solve_ik` brings each
    joint into its range by whole turns (eq. 12) and reports a joint that stays outside as ``joint_limits``.

    Differences: eq. (20) as printed moves a joint only where the clip is active, and stalls; ``literal=True`` does
    that. The printed settings (eta 0.01, E0 1e-8) do not give the printed tables; eta 0.1 and E0 1e-9 on the plain
    sum do, exactly.

    Args:
        eta: learning rate [rad per unit of dE/dq].
        E0: threshold on E; None: stop at the tolerances of `solve_ik`.
        step_limit: largest change of a joint in one iteration [rad or m].
        half_sum: E is half the sum of squares.
        literal: eq. (20) as printed.
        max_steps: the paper's I0.

    Raises:
        ConfigError: a setting is not positive.

    Example:
        >>> import ikgrad as ik, torch
        >>> robot = ik.load_robot("kr210")
        >>> q0 = torch.deg2rad(torch.tensor([0.0, -78.0, 183.0, 0.0, -45.0, -180.0]).double())
        >>> T = ik.forward_kinematics(robot, q0 + 0.05)
        >>> ik.solve_ik(robot, T, q0=q0, solver=ik.Apps()).success
        tensor(True)
    """

    eta: float = 0.1
    E0: float | None = None
    step_limit: float = math.pi / 180
    half_sum: bool = False
    literal: bool = False
    max_steps: int = 1000

    restarts = False

    def __post_init__(self) -> None:
        check_positive(self, eta=self.eta, step_limit=self.step_limit, max_steps=self.max_steps)
        if self.E0 is not None:
            check_positive(self, E0=self.E0)

    @classmethod
    def printed(cls) -> Apps:
        """The settings that the paper prints (they do not converge within its 1000 iterations)."""
        return cls(eta=0.01, E0=1e-8, half_sum=True)

    @classmethod
    def reproduces(cls) -> Apps:
        """The settings that give the paper's Tables 3 and 6 exactly."""
        return cls(eta=0.1, E0=1e-9, half_sum=False)

    def init(self, problem: Problem, q: Tensor) -> State:
        """Evaluate E and its gradient at the starts."""
        return self._evaluate(problem, q)

    def step(self, problem: Problem, state: State) -> State:
        """One limited gradient step."""
        dq = -self.eta * state.memory["gradient"]
        limited = dq.clamp(-self.step_limit, self.step_limit)
        if self.literal:
            limited = torch.where(dq.abs() > self.step_limit, limited, torch.zeros_like(dq))
        return self._evaluate(problem, state.q + limited)

    def energy(self, problem: Problem, q: Tensor) -> Tensor:
        """(B,) E of eq. (11), through the pytorch-kinematics chain."""
        robot = problem.robot
        T = robot.chain.forward_kinematics(robot.expand(q), end_only=True).get_matrix()
        e = (problem.T_target - T)[..., :3, :]
        if problem.mask is not None:
            Rt = problem.T_target[..., :3, :3].mT
            e = torch.cat(
                [(Rt @ e[..., :3]) * problem.mask[None, None, 3:], Rt @ e[..., 3:] * problem.mask[:3, None]], -1
            )
        E = e.square().sum(dim=(-2, -1))
        return E / 2 if self.half_sum else E

    def _evaluate(self, problem: Problem, q: Tensor) -> State:
        with torch.enable_grad():
            leaf = q.detach().requires_grad_()
            E = self.energy(problem, leaf)
            (gradient,) = torch.autograd.grad(E.sum(), leaf)
        position, rotation = problem.measure(q)
        done = problem.met(position, rotation) if self.E0 is None else E.detach() <= self.E0
        return State(q, position, rotation, done | ~E.isfinite(), {"gradient": gradient})
