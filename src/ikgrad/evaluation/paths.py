"""Following paths in closed loop: every answer is the present joints for the next pose."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from ikgrad.data.paths import Lines, clear_paths, joint_units, straight_lines
from ikgrad.evaluation.errors import measure
from ikgrad.evaluation.inverters import call, check_steps, in_words, robot_of, timed
from ikgrad.evaluation.records import PLAIN_STEPS, Answers, Evaluation, Protocol, Row
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot
from ikgrad.solvers.damped import damped_steps
from ikgrad.solvers.solve import solve_ik

POINTS = 200  # of a path
JUMP = 0.2  # rad (slides: typical lengths) in one joint, from a point to the next
_REPEATS = 2  # timings

_Answer = Callable[[Tensor, Tensor], Tensor]  # (P, 4, 4) poses and (P, n) last answers -> (P, n)


@dataclass(frozen=True)
class _Follow(Protocol):
    """What both kinds of path share."""

    poses: ClassVar[int] = 10_000
    says: ClassVar[str]

    @abstractmethod
    def _paths(self, robot: Robot, paths: int) -> Lines:
        """Joints that follow the paths, and the poses."""

    @torch.no_grad()
    def run(
        self, inverter: nn.Module, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = PLAIN_STEPS
    ) -> Evaluation:
        """See `Protocol.run`."""
        check_steps(solver_steps, plain_steps)
        robot = robot_of(inverter)
        lines = self._paths(robot.detach(), max(1, round(self._number / POINTS)))
        rows, answers = [], None
        for name, answer in _methods(robot, inverter, solver_steps, plain_steps).items():
            row, q = _measured(name, answer, robot, lines)
            rows.append(row)
            answers = answers or Answers(q.flatten(0, 1), lines.T.flatten(0, 1))
        own = float(_changes(robot, lines.q).max())
        note = (
            f"{len(lines.q)} paths of {POINTS} points, {self.says}; on the paths themselves no joint moves by more "
            f"than {own:.2g} rad from a point to the next. A reconfiguration is a joint that moves by more than "
            f"{JUMP:g} rad (slides: typical lengths) between two answers."
        )
        return Evaluation(
            robot.name,
            robot.fingerprint,
            f"{self.name}, closed loop",
            lines.T.shape[:2].numel(),
            self.seed,
            torch.get_num_threads(),
            tuple(rows),
            protocol=self.name,
            notes=(note,),
            answers=answers,
        )


@dataclass(frozen=True)
class Path(_Follow):
    """Smooth closed paths in joint space, mapped by forward kinematics; clear of limits and singularities.

    One to three sine waves of 0.5 rad a joint, see `ikgrad.data.paths.clear_paths`. All paths advance together. The
    first pose is asked from the joints of the path, every other one from the last answer. Beside the errors the table
    counts reconfigurations: joints that jump between two answers.

    Differences:
        IKLink plans the whole path and counts the reconfigurations that no plan can avoid; here an answer knows the
        next pose alone, and all that it does not follow smoothly counts. The threshold of 0.2 rad is ours.

    Source:
        Wang, Sifferman, Gleicher, IKLink: End-Effector Trajectory Tracking with Minimal Reconfigurations, 2024
        (arXiv 2402.16154), for what a reconfiguration is. The paths are those of `ikgrad bench ik --protocol path`.

    Example:
        >>> import ikgrad as ik
        >>> found = Path(count=400).run(ik.UnrolledInverter(ik.load_robot("panda"), width=8), plain_steps=(2,))
        >>> [row.method for row in found.rows][-2:]
        ['plain, 2 steps', 'solve_ik']
    """

    name: ClassVar[str] = "path"
    says: ClassVar[str] = "smooth in joint space"

    def _paths(self, robot: Robot, paths: int) -> Lines:
        q = clear_paths(robot, paths, POINTS, self._row_seed)
        return Lines(q, forward_kinematics(robot, q))


@dataclass(frozen=True)
class Line(_Follow):
    """Straight lines in task space that the arm can follow from their start, see `ikgrad.data.paths.straight_lines`.

    Measured as `Path` is.

    Source:
        As for `Path`; straight lines are what a tool is moved along.
    """

    name: ClassVar[str] = "line"
    says: ClassVar[str] = "straight lines that can be followed without a jump"

    def _paths(self, robot: Robot, paths: int) -> Lines:
        return straight_lines(robot, paths, POINTS, self._row_seed)


def _methods(robot: Robot, inverter: nn.Module, solver_steps: int, plain_steps: tuple[int, ...]) -> dict[str, _Answer]:
    def steps(count: int) -> _Answer:
        return lambda T, q: damped_steps(robot, T, q, steps=count).q

    def then(count: int) -> _Answer:
        return lambda T, q: damped_steps(robot, T, call(inverter, T, q), steps=count).q

    return {
        "inverter": lambda T, q: call(inverter, T, q),
        **{f"inverter + {in_words(k)}": then(k) for k in range(1, solver_steps + 1)},
        **{f"plain, {in_words(k)}": steps(k) for k in plain_steps},
        "solve_ik": lambda T, q: solve_ik(robot.detach(), T, q0=q).q,
    }


def _measured(name: str, answer: _Answer, robot: Robot, lines: Lines) -> tuple[Row, Tensor]:
    """One method on all paths: its row, and the (P, points, n) answers."""
    q, seconds = timed(lambda: _roll(answer, lines), repeats=_REPEATS)
    jumps = _changes(robot, q)
    above = ~(jumps <= JUMP)  # what is not finite counts
    extra = {
        "reconfigurations": float(above.sum()),
        "paths_with_one": float(above.any(dim=1).double().mean()),
        "largest_jump": float(jumps.nan_to_num(torch.inf).max()),
    }
    return Row(name, measure(robot, q, lines.T), seconds / jumps.numel() * 1e6, extra), q


def _roll(answer: _Answer, lines: Lines) -> Tensor:
    q, answers = lines.q[:, 0], []
    for T in lines.T.unbind(dim=1):
        found = answer(T, q)
        answers.append(found)
        q = torch.where(found.isfinite(), found, q)
    return torch.stack(answers, dim=1)


def _changes(robot: Robot, q: Tensor) -> Tensor:
    """(P, points - 1) the largest change of a joint; whole turns of a joint that may turn for ever do not count."""
    change = q.diff(dim=1)
    endless = robot.periodic.cpu() & ~(robot.q_min.isfinite() | robot.q_max.isfinite()).cpu()
    wrapped = torch.remainder(change + torch.pi, 2 * torch.pi) - torch.pi
    return (torch.where(endless, wrapped, change).abs() / joint_units(robot)).amax(dim=-1)


__all__ = ["JUMP", "POINTS", "Line", "Path"]
