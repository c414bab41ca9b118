"""Methods on the same target from the same start, every iterate kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.errors import RobotError
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.networks import IncrementInverter, load_inverter
from ikgrad.networks.places import ready_made
from ikgrad.networks.storage import AnyInverter
from ikgrad.robot import Robot
from ikgrad.solvers.apps import Apps
from ikgrad.solvers.base import Solver
from ikgrad.solvers.levenberg import LevenbergMarquardt
from ikgrad.solvers.newton import NewtonRaphson
from ikgrad.solvers.solve import trace_ik

TOLERANCE = 1e-6  # m and rad
METHODS: dict[str, Solver] = {
    "APPS": Apps(),
    "Newton-Raphson": NewtonRaphson(),
    "Levenberg-Marquardt": LevenbergMarquardt(max_starts=1, compiled=False),
}
INVERTER = "neural inverter"


class Run(NamedTuple):
    """The way of one method.

    Attributes:
        name: of the method.
        q: (k, n) iterates, the start first.
        position_error: (k,) [m]
        rotation_error: (k,) [rad]
        words: how it ended.
    """

    name: str
    q: Tensor
    position_error: Tensor
    rotation_error: Tensor
    words: str

    @property
    def met(self) -> bool:
        """The last iterate is within 1e-6 m and rad of the target."""
        return float(self.position_error[-1]) <= TOLERANCE and float(self.rotation_error[-1]) <= TOLERANCE

    def at(self, iteration: int) -> int:
        """Index of an iteration, or of the last if the method has ended before."""
        return min(iteration, len(self.q) - 1)


def race(
    robot: Robot,
    T_target: Tensor,
    q0: Tensor,
    *,
    mask: Sequence[float] | None = None,
    inverter: AnyInverter | None = None,
) -> list[Run]:
    """Run the methods of `METHODS` from one start, and the inverter.

    Levenberg-Marquardt gets no second start here, unlike in `solve_ik`, and alone keeps the joint limits on its way.

    Args:
        robot: the robot, n joint variables.
        T_target: (4, 4) wanted pose [m].
        q0: (n,) start.
        mask: which errors count, see `solve_ik`; an inverter has learnt whole poses, and is left out if there is one.
        inverter: its answers, round by round if it gives them.

    Example:
        >>> import ikgrad as ik, torch
        >>> robot = ik.load_robot("ur5e")
        >>> q = torch.tensor([0.3, -1.2, 1.4, -0.9, -1.5, 0.2]).double()
        >>> runs = race(robot, ik.forward_kinematics(robot, q), q + 0.1)
        >>> [run.words[:7] for run in runs]
        ['reached', 'reached', 'reached']
    """
    runs = []
    for name, solver in METHODS.items():
        trace = trace_ik(robot, T_target, q0=q0, solver=solver, tol_pos=TOLERANCE, tol_rot=TOLERANCE, mask=mask)
        run = _finished(robot, name, *trace)
        if isinstance(solver, LevenbergMarquardt) and not run.met and len(run.q) > 1:
            run = _finished(
                robot, name, *(column[:-1] for column in trace)
            )  # the last is a new start, drawn and not used
        runs.append(run)
    if inverter is not None and mask is None:
        q = torch.stack([q0, *answers(inverter, T_target, q0)])
        e = pose_error(forward_kinematics(robot, q), T_target)
        runs.append(_finished(robot, INVERTER, q, e[:, :3].norm(dim=-1), e[:, 3:].norm(dim=-1)))
    return runs


@torch.no_grad()
def answers(inverter: AnyInverter, T_target: Tensor, q0: Tensor) -> list[Tensor]:
    """(n,) float64 answers of an inverter to one pose: one, or one a round."""
    if isinstance(inverter, IncrementInverter):
        low, high = inverter.robot.q_min, inverter.robot.q_max
        return [q[0].clamp(low, high) for q in inverter.iterates(T_target[None].double(), q0[None].double())]
    T, q = T_target.to(inverter.dtype), q0.to(inverter.dtype)
    return [(inverter(T, q) if inverter.feedback else inverter(T)).double()]


def inverter_for(robot: Robot) -> AnyInverter | None:
    """The ready-made inverter of a robot, None if there is none for exactly this one."""
    if robot.name not in ready_made():
        return None
    try:
        return load_inverter(robot.name, robot=robot)
    except RobotError:  # another arm of this name, or another tip
        return None


def iterations_to_show(runs: Sequence[Run], *, per_decade: int = 40) -> list[int]:
    """Which iterations to play: each of the first, then ever fewer, so that 10 and 1,000 can be watched together."""
    last = max(len(run.q) for run in runs) - 1
    shown, k = [], 0
    while k < last:
        shown.append(k)
        k += max(1, round(k * (10 ** (1 / per_decade) - 1)))
    return [*shown, last]


def curves(runs: Sequence[Run], *, floor: float = 1e-12) -> tuple[Tensor, Tensor]:
    """Errors for a chart with two logarithmic axes.

    Args:
        runs: r runs.
        floor: what an error of zero is drawn as [m].

    Returns:
        (k,) iterations counted from 1, and (r, k) position errors [m]; a method that has ended keeps its last one.
    """
    longest = max(len(run.q) for run in runs)
    rows = [torch.cat([e := run.position_error.double(), e[-1:].expand(longest - len(e))]) for run in runs]
    return torch.arange(1, longest + 1).double(), torch.stack(rows).nan_to_num(nan=floor).clamp(floor, 1e3)


def _finished(robot: Robot, name: str, q: Tensor, position: Tensor, rotation: Tensor) -> Run:
    """A run without iterates that are not finite; its words name the end, or the iterate that `solve_ik` would keep."""
    good = position.isfinite() & q.isfinite().all(dim=-1)
    run = Run(name, q[good], position[good], rotation[good], "")
    steps = f"{len(run.q) - 1:,} step" + "s" * (len(run.q) != 2)
    if run.met:
        return run._replace(words=f"reached in {steps}")
    best = int((run.position_error / robot.length + run.rotation_error).argmin())
    missing = (
        f"{1e3 * float(run.position_error[best]):.3g} mm and {math.degrees(float(run.rotation_error[best])):.2g} deg"
    )
    return run._replace(words=f"nearest {missing}, ended after {steps}")


__all__ = ["INVERTER", "METHODS", "Run", "answers", "curves", "inverter_for", "iterations_to_show", "race"]
