"""What the arm does when somebody turns a joint or moves the target, and what there is to say about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.data import sample_configurations
from ikgrad.errors import ConfigError
from ikgrad.kinematics import check_q, forward_kinematics, jacobian, link_poses, pose_error
from ikgrad.robot import Robot
from ikgrad.solvers.damped import MAX_STEP, typical_length
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.solution import Reason
from ikgrad.solvers.solve import solve_ik

POSITION_ONLY = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
GHOSTS = 8

_QUICK = LevenbergMarquardt(max_starts=4)  # while the target moves: a full search may take a tenth of a second
_FULL = LevenbergMarquardt()
_STEPS = {True: 60, False: 6}  # towards a target that is not reached; while it moves the next answer goes on


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of a target.

    Attributes:
        q: (n,) joints to show: a solution, or where the way from the present joints towards the target ends.
        success: a solution.
        reason: a name of `ikgrad.Reason`.
        words: the same for people.
        position_error: of ``q`` [m].
        rotation_error: of ``q`` [rad].
    """

    q: Tensor
    success: bool
    reason: str
    words: str
    position_error: float
    rotation_error: float


class Session:
    """The present joints and target of one arm.

    Args:
        robot: the robot, n joint variables.
        q: (n,) joints to begin with and to come back to [rad or m]; default: `comfortable`.
        position_only: do not ask for an orientation; default: for arms with fewer than six joints.

    Raises:
        ShapeError: ``q`` is not n values.
        ConfigError: ``q`` is outside the limits.

    Example:
        >>> import ikgrad as ik
        >>> session = Session(ik.load_robot("panda"))
        >>> target = session.T_target.clone()
        >>> target[2, 3] -= 0.1
        >>> session.reach(target).words
        'reached'
    """

    def __init__(self, robot: Robot, *, q: Tensor | None = None, position_only: bool | None = None):
        self.robot = robot
        self.home = comfortable(robot) if q is None else _checked(robot, q)
        self.mask = POSITION_ONLY if (robot.dof < 6 if position_only is None else position_only) else None
        self.reset()

    def reset(self) -> None:
        """Back to where it began, the target at the tool."""
        self.move_joints(self.home)

    def ask_orientation(self, wanted: bool) -> None:
        """Whether the target's orientation counts."""
        self.mask = None if wanted else POSITION_ONLY

    def move_joints(self, q: Tensor) -> None:
        """Put the arm there, inside its limits or not; the target comes along."""
        self.q = q.to(torch.float64)
        self.T_target = forward_kinematics(self.robot, self.q)

    def reach(self, T_target: Tensor, *, thorough: bool = True) -> Answer:
        """Go to a target: from the present joints if that works, else from anywhere, else as near as can be.

        Args:
            T_target: (4, 4) wanted pose [m].
            thorough: search as long as `solve_ik` does; False while a target is dragged.
        """
        self.T_target = T_target
        solver = _FULL if thorough else _QUICK
        found = solve_ik(self.robot, T_target, q0=self.q, solver=solver, mask=self.mask)
        if bool(found.success):
            self.q = found.q
        elif int(found.reason_code) != Reason.invalid_target:
            self.q = approach(self.robot, T_target, self.q, position_only=self.mask is not None, steps=_STEPS[thorough])
        position, rotation = self._missing()
        words = explain(self.robot, int(found.reason_code), T_target, position, None if self.mask else rotation)
        return Answer(self.q, bool(found.success), str(found.reason), words, position, rotation)

    def solutions(self, count: int = GHOSTS) -> Tensor:
        """(k, n) different joints for the present target, nearest first, k <= count; none if there is no solution.

        An arm with spare joints has endlessly many; these are then examples.
        """
        found = solve_ik(self.robot, self.T_target, q0=self.q, solutions=max(count, 2), mask=self.mask)
        return found.q[found.success][:count]

    def poses(self, q: Tensor) -> Tensor:
        """(..., links, 4, 4) of joints (..., n)."""
        return link_poses(self.robot, q)

    def _missing(self) -> tuple[float, float]:
        """Position [m] and rotation [rad] between tool and target; NaN if the target is no transform."""
        e = pose_error(forward_kinematics(self.robot, self.q), self.T_target)
        return float(e[:3].norm()), float(e[3:].norm())


def approach(robot: Robot, T_target: Tensor, q: Tensor, *, position_only: bool = False, steps: int = 60) -> Tensor:
    """(n,) as near to a target as steps downhill lead, inside the limits; never farther away than the start.

    Levenberg-Marquardt on |e|^2, e = [(p* - p) / L; log(R* R^T)], where a step that does not lower it is refused and
    damped more. (The steps of `solve_ik` may rise; an arm that is stretched out would tremble.)

    Args:
        robot: the robot, n joint variables.
        T_target: (4, 4) the target [m].
        q: (n,) where to start.
        position_only: do not turn the tool.
        steps: at most so many.
    """
    low, high, length = robot.q_min, robot.q_max, typical_length(robot)
    unit = torch.ones_like(q).masked_fill(~robot.revolute, length)
    weight = q.new_tensor([1 / length] * 3 + [0.0 if position_only else 1.0] * 3)
    q, damping = q.clamp(low, high), 1e-2
    e, J = _linearised(robot, T_target, q, weight)
    for _ in range(steps):
        slope = J.mT @ e
        free = J.masked_fill(((q >= high) & (slope > 0)) | ((q <= low) & (slope < 0)), 0.0) * unit
        A = free @ free.mT + damping * torch.eye(6).to(e)
        tried = (q + unit * (free.mT @ torch.linalg.solve(A, e)).clamp(-MAX_STEP, MAX_STEP)).clamp(low, high)
        e_tried, J_tried = _linearised(robot, T_target, tried, weight)
        gain = 1 - float(e_tried @ e_tried) / max(float(e @ e), 1e-30)
        if gain > 0:
            q, e, J, damping = tried, e_tried, J_tried, 0.2 * damping
        else:
            damping = 5 * damping
        if 0 < gain < 1e-7 or damping > 1e6:
            break
    return q


def _linearised(robot: Robot, T_target: Tensor, q: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    e = pose_error(forward_kinematics(robot, q), T_target)
    return e * weight, jacobian(robot, q) * weight[:, None]


def explain(robot: Robot, code: int, T_target: Tensor, position_error: float, rotation_error: float | None) -> str:
    """The reason of one answer in a sentence.

    Args:
        robot: the robot.
        code: of `ikgrad.Reason`.
        T_target: (4, 4) the target.
        position_error: what is missing where the arm is shown [m].
        rotation_error: likewise [rad]; None: it does not count.
    """
    missing = f"{1e3 * position_error:.1f} mm"
    if rotation_error is not None:
        missing += f" and {math.degrees(rotation_error):.1f} deg"
    reason = Reason(code)
    if reason is Reason.converged:
        return "reached"
    if reason is Reason.unreachable:
        shoulder = robot.detach().tables().origins[0, :3, 3]
        distance = float((T_target[:3, 3] - shoulder).norm())
        return (
            f"out of reach: the target is {distance:.2f} m from the first joint, the links together are at most "
            f"{robot.reach_bound:.2f} m long{_wrist(robot, distance)}; missing {missing}"
        )
    if reason is Reason.joint_limits:
        return f"joint limits: the arm could be there only with a joint outside its limits; missing {missing}"
    if reason is Reason.invalid_target:
        return "the target is no rigid transform"
    return f"no solution found, from here or from any other start (there may be one); missing {missing}"


def _wrist(robot: Robot, distance: float) -> str:
    """The bound that counts when the target itself is near enough."""
    return " and with this orientation the wrist is too far away" if distance <= robot.reach_bound else ""


def comfortable(robot: Robot) -> Tensor:
    """(n,) joints well inside their ranges, links above the floor, far from singular: a place to start from.

    Of 256 random configurations in the middle 60 % of the ranges (at most +-1.5 rad), the one with the largest
    product of singular values of the Jacobian.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> bool((ik.link_poses(robot, comfortable(robot))[:, 2, 3] >= 0).all())
        True
    """
    low, high = robot.sampling_range
    low, high = (limit.to("cpu", torch.float64) for limit in (low, high))
    middle, half = (low + high) / 2, (0.3 * (high - low)).clamp(max=1.5)
    q = sample_configurations(robot, 256, seed=0).to(torch.float64)
    q = middle + (q - middle) * (half / (high - low).clamp(min=1e-9) * 2)
    dexterity = torch.linalg.svdvals(jacobian(robot, q)).clamp(min=1e-12).log().sum(dim=-1)
    heights = link_poses(robot, q)[:, :, 2, 3]
    above = heights.amin(dim=-1) >= min(-1e-9, float(heights.amin(dim=-1).max()))
    return q[dexterity.where(above, -math.inf).argmax()]


def _checked(robot: Robot, q: Tensor) -> Tensor:
    check_q(robot, q)
    if q.ndim != 1 or not bool(((q >= robot.q_min) & (q <= robot.q_max)).all()):
        raise ConfigError(f"q must be {robot.dof} values inside the joint limits, got {q.tolist()}")
    return q.to(torch.float64)


__all__ = ["GHOSTS", "POSITION_ONLY", "Answer", "Session", "approach", "comfortable", "explain"]
