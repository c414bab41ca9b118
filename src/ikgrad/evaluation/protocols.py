"""Protocols of poses: the local and the global task, and IKFlow's; see `tracik` and `paths` for the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import nn

from ikgrad.data import TaskStream, sample_configurations
from ikgrad.data.stream import LOCAL
from ikgrad.evaluation.inverters import evaluate, robot_of, side_by_side, takes_joints
from ikgrad.evaluation.records import PLAIN_STEPS, Evaluation, Protocol
from ikgrad.kinematics import forward_kinematics

IKFLOW = {
    "panda": {
        "source": (
            "model_performances.md of github.com/jstmn/ikflow, 11 January 2024: panda__full__lp191_5.25m, 12 coupling "
            "layers, 250 poses"
        ),
        "mean_position_mm": 6.66,
        "mean_rotation_deg": 2.03,
    }
}
"""Means that IKFlow's authors publish, by robot."""


@dataclass(frozen=True)
class Local(Protocol):
    """A target nearby: the pose of joints within 0.5 rad of the present ones (slides: 0.5 typical lengths).

    What a controller asks at every tick, at the hardest. Present joints are uniform in the limits, the target's joints
    uniform in the box around them.

    Source:
        This project; the task that `ikgrad.data.TaskStream` trains.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> found = Local(count=100).run(ik.UnrolledInverter(robot, width=8))
        >>> found.protocol, found.count, found.rows[0].method
        ('local', 100, 'inverter')
    """

    name: ClassVar[str] = "local"
    poses: ClassVar[int] = 10_000
    spread: ClassVar[float | None] = LOCAL

    def run(
        self, inverter: nn.Module, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = PLAIN_STEPS
    ) -> Evaluation:
        """See `Protocol.run`."""
        task = TaskStream(robot_of(inverter), batch_size=self._number, spread=self.spread, seed=self._row_seed)
        found = evaluate(inverter, task, solver_steps=solver_steps, plain_steps=plain_steps)
        return replace(found, protocol=self.name, seed=self.seed)


@dataclass(frozen=True)
class Global(Local):
    """A target anywhere: the present joints and those of the target are both uniform in the limits.

    Source:
        This project; the pose of uniform joints is what most papers on learnt inverse kinematics ask for.
    """

    name: ClassVar[str] = "global"
    spread: ClassVar[float | None] = None


@dataclass(frozen=True)
class IKFlow(Protocol):
    """Many answers for each of 500 poses, and the means of their errors.

    500 poses of uniform joints. IKFlow draws 50 latent vectors for each and answers each of them; here an inverter is
    asked from 50 random present joints, and one that does not look at the present joints answers once.

    Differences:
        IKFlow leaves out poses of configurations in which the arm touches itself; here they are in. Its published
        means are quoted beside ours for `panda`, never measured.

    Source:
        Ames, Morgan, Konidaris, IKFlow: Generating Diverse Inverse Kinematics Solutions, IEEE RA-L 7(3), 2022; the
        defaults of scripts/evaluate.py in github.com/jstmn/ikflow.
    """

    name: ClassVar[str] = "ikflow"
    poses: ClassVar[int] = 500
    samples: ClassVar[int] = 50  # a pose

    def run(
        self, inverter: nn.Module, *, solver_steps: int = 3, plain_steps: tuple[int, ...] = PLAIN_STEPS
    ) -> Evaluation:
        """See `Protocol.run`."""
        robot = robot_of(inverter)
        samples = self.samples if takes_joints(inverter) else 1
        drawn = sample_configurations(robot, self._number * (1 + samples), seed=self._row_seed).cpu().double()
        q, q_current = drawn[: self._number], drawn[self._number :]
        T = forward_kinematics(robot.detach(), q).repeat_interleave(samples, dim=0)
        rows, answers = side_by_side(inverter, T, q_current, solver_steps=solver_steps, plain_steps=plain_steps)
        means = [
            {"mean_position_mm": row.errors.mean_position_mm, "mean_rotation_deg": row.errors.mean_rotation_deg}
            for row in rows
        ]
        published = IKFLOW.get(robot.name, {})
        return Evaluation(
            robot.name,
            robot.fingerprint,
            f"ikflow, {self._number:,} poses x {samples} present joints" if samples > 1 else "ikflow",
            len(T),
            self.seed,
            torch.get_num_threads(),
            tuple(replace(row, extra=extra) for row, extra in zip(rows, means, strict=True)),
            protocol=self.name,
            notes=_notes(samples, published),
            published=published,
            answers=answers,
        )


def _notes(samples: int, published: dict[str, object]) -> tuple[str, ...]:
    notes = []
    if samples == 1:
        notes.append("The inverter does not look at the present joints: one answer a pose.")
    if published:
        mm, deg = published["mean_position_mm"], published["mean_rotation_deg"]
        notes.append(f"IKFlow: mean {mm} mm and {deg} deg, published, not measured here ({published['source']}).")
    return tuple(notes)


__all__ = ["IKFLOW", "Global", "IKFlow", "Local"]
