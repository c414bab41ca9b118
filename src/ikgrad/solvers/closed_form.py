"""`Puma560ClosedForm`: the closed form of the PUMA 560 as a method of `solve_ik`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.errors import ConfigError
from ikgrad.kinematics import pose_and_jacobian
from ikgrad.robot import Robot, load_robot
from ikgrad.solvers.attempt import whole_turns
from ikgrad.solvers.base import State
from ikgrad.solvers.problem import Problem
from ikgrad.solvers.puma560 import solve_branches

_SLICE = 512  # rows whose eight branches torch handles in one thread: sharing such short work costs more than it saves


@dataclass(frozen=True)
class Puma560ClosedForm:
    """The branch of `puma560_ik` that is nearest to ``q0``, as a method of `solve_ik`.

    "Nearest" means the smallest largest joint change, over whole turns too; without ``q0`` from the middle of the
    range. A branch inside the limits goes before any other. At a wrist singularity th4 stays as it is in ``q0``.
    ``solutions=8`` gives all branches. The robot may be any whose joint axes lie as those of ``puma560``, wherever
    its link frames are and whatever tool it carries; its own limits count.

    One evaluation (``steps`` is 1). Whole poses only: a ``mask`` is refused.

    Raises:
        ConfigError: in `solve_ik`, if the robot has another geometry, or a mask is given.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("puma560")
        >>> q = ik.sample_configurations(robot, 100, seed=0)
        >>> solution = ik.solve_ik(robot, ik.forward_kinematics(robot, q), q0=q, solver=ik.Puma560ClosedForm())
        >>> bool(((solution.q - q).abs() < 1e-6).all())
        True
    """

    max_steps = 1
    restarts = False

    def init(self, problem: Problem, q: Tensor) -> State:
        """Choose a branch for (B, n) starts and evaluate it; nothing is left to do."""
        rows = _SLICE if q.device.type == "cpu" else max(len(q), 1)
        slices = zip(self._flange(problem).split(rows), q.split(rows), strict=True)
        nearest = torch.cat([_nearest(problem, _near(problem, T, start), start) for T, start in slices])
        position, rotation = problem.measure(nearest)
        return State(nearest, position, rotation, torch.ones_like(position, dtype=torch.bool))

    def step(self, problem: Problem, state: State) -> State:
        """Nothing to do: `init` was final."""
        return state

    def every_branch(self, problem: Problem, near: Tensor) -> Tensor:
        """(B, 8, 6) branches, by whole turns as near to (B, 6) joints as the limits allow."""
        return _near(problem, self._flange(problem), near)

    def out_of_reach(self, problem: Problem) -> Tensor:
        """(B,) True where no branch reaches the pose, whatever the limits."""
        return ~solve_branches(self._flange(problem))[1].any(dim=-1)

    def _flange(self, problem: Problem) -> Tensor:
        """(B, 16) targets of the flange, the robot's tool taken off."""
        if problem.mask is not None:
            raise ConfigError("Puma560ClosedForm solves whole poses; leave the mask out, or use LevenbergMarquardt")
        return (problem.T_target @ _tool_inverse(problem.robot)).flatten(1)


def _near(problem: Problem, T_flange: Tensor, near: Tensor) -> Tensor:
    """(B, 8, 6) branches of (B, 16) flange poses, by whole turns as near to (B, 6) joints as the limits allow."""
    q, _, _ = solve_branches(T_flange, (problem.q_min, problem.q_max), near[:, 3])
    return whole_turns(problem, q, near[:, None])


def _nearest(problem: Problem, branches: Tensor, q: Tensor) -> Tensor:
    """(B, 6) the one of (B, 8, 6) branches with the smallest largest joint change, those inside the limits first."""
    outside = ~((branches >= problem.q_min) & (branches <= problem.q_max)).all(dim=-1)
    change = (branches - q[:, None]).abs().amax(dim=-1) + 1e3 * outside  # (B, 8)
    return branches[torch.arange(len(q), device=q.device), change.argmin(dim=1)]


def _tool_inverse(robot: Robot) -> Tensor:
    """(4, 4) pose of the PUMA 560's flange in the robot's tip; refuses every robot that is no PUMA 560.

    Equal screw axes at q = 0 are equal arms: T = exp(S1 q1) ... exp(S6 q6) T(0), and T(0) alone knows the tool.
    """
    screws, home = _screws(load_robot("puma560"))
    tables = robot.tables()
    if robot.dof == 6 and len(tables.variable) == 6 and not bool(tables.prismatic.any()):
        own_screws, own_home = _screws(robot)
        if bool(((own_screws - screws).abs() <= 1e-9).all()):
            return (torch.linalg.inv(own_home) @ home).to(robot.device)
    raise ConfigError(
        f"Puma560ClosedForm: robot '{robot.name}' has not the joint axes of the built-in puma560; "
        "LevenbergMarquardt solves any robot"
    )


def _screws(robot: Robot) -> tuple[Tensor, Tensor]:
    """(6, n) twists of the joints at q = 0 about the base's origin, [linear; angular], and the (4, 4) pose there."""
    T, J = pose_and_jacobian(robot, torch.zeros(robot.dof, dtype=torch.float64))
    p = T[:3, 3, None].expand(3, robot.dof)
    return torch.cat([J[:3] + torch.linalg.cross(p, J[3:], dim=0), J[3:]]), T
