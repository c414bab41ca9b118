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
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.solution import Reason
from ikgrad.solvers.solve import solve_ik
from ikgrad.view.follow import Method, Step, levenberg_marquardt

POSITION_ONLY = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
GHOSTS = 8
STARTS = 128  # from which examples are looked for


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of a target.

    Attributes:
        q: (n,) joints to show: a solution, or where the method has led.
        success: a solution.
        reason: a name of `ikgrad.Reason`.
        words: the same for people.
        position_error: of ``q`` [m].
        rotation_error: of ``q`` [rad].
        more: the method goes on from ``q`` if it is asked again.
        near: no solution, and none was promised: an inverter's answer.
    """

    q: Tensor
    success: bool
    reason: str
    words: str
    position_error: float
    rotation_error: float
    more: bool = False
    near: bool = False


class Session:
    """The present joints and target of one arm.

    Args:
        robot: the robot, n joint variables.
        q: (n,) joints to begin with and to come back to [rad or m]; default: `comfortable`.
        position_only: do not ask for an orientation; default: for arms with fewer than six joints.

    Attributes:
        q: (n,) present joints.
        T_target: (4, 4) present target [m].
        method: of `ikgrad.view.follow`; the default is Levenberg-Marquardt.

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
        self.method: Method = levenberg_marquardt
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
        """Go to a target by the method that is chosen; Levenberg-Marquardt goes as near as can be if it must.

        Args:
            T_target: (4, 4) wanted pose [m].
            thorough: search as long as `solve_ik` does; False while a target is dragged.
        """
        self.T_target = T_target
        step = self.method(self.robot, T_target, self.q, mask=self.mask, thorough=thorough)
        self.q = step.q
        position, rotation = self._missing()
        words = self._say(step, position, rotation)
        success = step.code == Reason.converged
        near = not success and not step.exact and step.code == Reason.no_convergence
        return Answer(self.q, success, Reason(step.code).name, words, position, rotation, step.more, near)

    def _say(self, step: Step, position: float, rotation: float) -> str:
        counted = None if self.mask else rotation
        if step.said and step.code in (Reason.no_convergence, Reason.joint_limits):
            return f"{step.said}; missing {missing(position, counted)}"
        return explain(self.robot, step.code, self.T_target, position, counted)

    @property
    def spare(self) -> bool:
        """More joints than the target needs: solutions come in endless families."""
        return self.robot.dof > (3 if self.mask else 6)

    def solutions(self, count: int = GHOSTS) -> Tensor:
        """(k, n) different joints for the present target, nearest first, k <= count; none if there is no solution.

        An arm with spare joints has endlessly many; these are then examples, as different as can be.
        """
        if self.spare:
            return self._examples(count)
        found = solve_ik(self.robot, self.T_target, q0=self.q, solutions=max(count, 2), mask=self.mask)
        return found.q[found.success][:count]

    def _examples(self, count: int) -> Tensor:
        """Of the answers from many starts the one nearest to the present joints, then always the farthest from all."""
        starts = sample_configurations(self.robot, STARTS, seed=0)
        starts[0] = self.q.clamp(self.robot.q_min, self.robot.q_max)
        T = self.T_target.expand(STARTS, 4, 4)
        found = solve_ik(self.robot, T, q0=starts, solver=LevenbergMarquardt(max_starts=1), mask=self.mask)
        q = found.q[found.success]
        if len(q) == 0:
            return q
        chosen = [q[(q - self.q).abs().amax(dim=-1).argmin()]]
        far = (q - chosen[0]).abs().amax(dim=-1)
        while len(chosen) < count and float(far.max()) > 1e-3:
            chosen.append(q[far.argmax()])
            far = torch.minimum(far, (q - chosen[-1]).abs().amax(dim=-1))
        return torch.stack(sorted(chosen, key=lambda row: float((row - self.q).abs().max())))

    def poses(self, q: Tensor) -> Tensor:
        """(..., links, 4, 4) of joints (..., n)."""
        return link_poses(self.robot, q)

    def _missing(self) -> tuple[float, float]:
        """Position [m] and rotation [rad] between tool and target; NaN if the target is no transform."""
        e = pose_error(forward_kinematics(self.robot, self.q), self.T_target)
        return float(e[:3].norm()), float(e[3:].norm())


def explain(robot: Robot, code: int, T_target: Tensor, position_error: float, rotation_error: float | None) -> str:
    """The reason of one answer in a sentence.

    Args:
        robot: the robot.
        code: of `ikgrad.Reason`.
        T_target: (4, 4) the target.
        position_error: what is missing where the arm is shown [m].
        rotation_error: likewise [rad]; None: it does not count.
    """
    reason, left = Reason(code), missing(position_error, rotation_error)
    if reason is Reason.converged:
        return "reached"
    if reason is Reason.unreachable:
        shoulder = robot.detach().tables().origins[0, :3, 3]
        distance = float((T_target[:3, 3] - shoulder).norm())
        return (
            f"out of reach: the target is {distance:.2f} m from the first joint, the links together are at most "
            f"{robot.reach_bound:.2f} m long{_wrist(robot, distance)}; missing {left}"
        )
    if reason is Reason.joint_limits:
        return f"joint limits: the arm could be there only with a joint outside its limits; missing {left}"
    if reason is Reason.invalid_target:
        return "the target is no rigid transform"
    return f"no solution found, from here or from any other start (there may be one); missing {left}"


def missing(position_error: float, rotation_error: float | None) -> str:
    """What is missing: ``"1.2 mm and 0.3 deg"``."""
    turned = "" if rotation_error is None else f" and {math.degrees(rotation_error):.1f} deg"
    return f"{1e3 * position_error:.1f} mm{turned}"


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


__all__ = ["GHOSTS", "POSITION_ONLY", "Answer", "Session", "comfortable", "explain"]
