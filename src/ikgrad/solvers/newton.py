"""Newton-Raphson with the pseudo-inverse: the textbook method, and the baseline of the APPS paper."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.kinematics import forward_kinematics
from ikgrad.solvers.base import State, check_positive
from ikgrad.solvers.problem import Problem, tool_frame_rotation_error


@dataclass(frozen=True)
class NewtonRaphson:
    """Full Newton steps on the pose error: q <- q + J^+ [p* - p; log(R* R^T)].

    J is the geometric Jacobian and both errors are in the base frame; J^+ is the Moore-Penrose inverse, so redundant
    arms take the smallest step. Nothing is damped: near singular configurations the steps are wild.

    Args:
        tool_frame_error: take the rotation error in the frame of the tool, log(R^T R*), and still use the
            base-frame Jacobian. That is inconsistent and does not converge in general; it is the likely cause of the
            Newton-Raphson rows in Table 6 of the APPS paper.
        max_steps: evaluations of the error allowed.

    Raises:
        ConfigError: ``max_steps`` is not positive.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> q = ik.sample_configurations(robot, 3, seed=0)
        >>> T = ik.forward_kinematics(robot, q)
        >>> ik.solve_ik(robot, T, q0=q + 0.1, solver=ik.NewtonRaphson(), limits=False).steps <= 10
        tensor([True, True, True])
    """

    tool_frame_error: bool = False
    max_steps: int = 100

    restarts = False

    def __post_init__(self) -> None:
        check_positive(self, max_steps=self.max_steps)

    def init(self, problem: Problem, q: Tensor) -> State:
        """Evaluate the starts."""
        return self._evaluate(problem, q)

    def step(self, problem: Problem, state: State) -> State:
        """One full step."""
        e, J = problem.linearise(state.q)
        if self.tool_frame_error:
            rotation = tool_frame_rotation_error(forward_kinematics(problem.robot, state.q), problem.T_target)
            e = torch.cat([e[..., :3], rotation], dim=-1)
        dq = (torch.linalg.pinv(J) @ e[..., None])[..., 0]
        return self._evaluate(problem, state.q + dq)

    def _evaluate(self, problem: Problem, q: Tensor) -> State:
        position, rotation = problem.measure(q)
        finite = position.isfinite() & (q.abs() < 1e9).all(dim=-1)  # beyond, an angle has lost its digits
        return State(q, position, rotation, problem.met(position, rotation) | ~finite)
