"""The work behind ``ikgrad solve``: poses in, parts on disk, one file of joints out. Prints nothing."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

import ikgrad
from ikgrad import __version__
from ikgrad.cli.terminal import Interrupted, Progress
from ikgrad.errors import DataError, IkgradError, describe
from ikgrad.files import JointFile, PartialRun, PoseFile, joint_writer
from ikgrad.files.joints import REASONS
from ikgrad.files.poses import Targets
from ikgrad.files.writers import Columns, decoded
from ikgrad.jobs.answers import HIDDEN, Summary, answer_columns
from ikgrad.kinematics import forward_kinematics
from ikgrad.solvers.solve import solve_ik

if TYPE_CHECKING:
    from ikgrad.robot import Robot


class Pace:
    """How many rows to solve in one call: more and more, until a call takes a few seconds."""

    def __init__(self, size: int = 256, enough: float = 3.0):
        self.size, self._enough, self._start = size, enough, 0.0

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        if time.perf_counter() - self._start < self._enough:
            self.size *= 4


@dataclass(frozen=True)
class Job:
    """Everything that the answer depends on.

    Attributes:
        robot: the robot.
        poses: the targets.
        q0: starts, as many rows as poses, or one for all; or None.
        settings: keyword arguments of `ikgrad.solve_ik`.
        chunk: rows solved, and kept, at a time.
    """

    robot: Robot
    poses: PoseFile
    q0: JointFile | None
    settings: Mapping[str, Any]
    chunk: int
    _pace: Pace = field(default_factory=lambda: Pace())

    def __post_init__(self) -> None:
        if self.q0 is not None and self.q0.total not in {1, self.poses.total}:
            rows, wanted = self.q0.total, self.poses.total
            raise DataError(
                f"{self.q0.path}: has {rows:,} rows, expected {wanted:,}, one for each pose (or one for all)"
            )

    def manifest(self) -> dict[str, Any]:
        """What must be the same for parts to fit together."""
        return {
            "ikgrad version": __version__,
            "robot fingerprint": self.robot.fingerprint,
            "content of the poses": _digest(self.poses.path),
            "content of q0": _digest(self.q0.path) if self.q0 else None,
            "repair": self.poses.repair,
            "rows at a time": self.chunk,
            **{name: value if isinstance(value, int | float) else repr(value) for name, value in self.settings.items()},
        }

    def warm_up(self) -> None:
        """Load the kernels and the robot's tables, so that the rate that is shown is that of the work."""
        low, high = self.robot.sampling_range
        q = (low + high) / 2
        ikgrad.solve_ik(self.robot, forward_kinematics(self.robot, q), q0=q, **self.settings)

    def starts(self) -> Iterator[torch.Tensor | None]:
        """q0 for each chunk of poses."""
        if self.q0 is None or self.q0.total == 1:
            one = None if self.q0 is None else next(self.q0.chunks(1))[0]
            while True:
                yield one
        yield from self.q0.chunks(self.chunk)

    def solve(self, run: PartialRun, progress: Progress) -> None:
        """Solve what is not finished yet; an interrupt leaves the finished parts."""
        first = 0
        starts = self.starts()
        for index, targets in enumerate(self.poses.chunks(self.chunk)):
            q0 = next(starts)
            if index in run.finished:
                progress.skip(len(targets.T))
            else:
                columns = self._answer(targets, q0, first, progress)
                run.save(index, columns)
            first += len(targets.T)

    def _answer(self, targets: Targets, q0: torch.Tensor | None, first: int, progress: Progress) -> Columns:
        """Solve one part, in several calls if they are slow, so that there is something to tell meanwhile.

        Rows do not depend on each other, so the timing that decides on the split changes no bit of the answer.
        """
        pieces, done = [], 0
        while done < len(targets.T):
            rows = slice(done, done + self._pace.size)
            start = q0[rows] if q0 is not None and q0.ndim == 2 else q0
            T, deviation = targets.T[rows], targets.deviation[rows]
            with self._pace:
                solution = solve_ik(self.robot, T, q0=start, **self.settings)
            pieces.append(answer_columns(solution, deviation, first=first + done))
            progress.advance(len(T))
            done += len(T)
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}

    def assemble(self, run: PartialRun, output: Path, *, force: bool, keep: Columns | None) -> Summary:
        """Put the parts together, in order.

        Args:
            run: the finished parts.
            output: the file to be.
            force: overwrite it.
            keep: filled with errors, steps and reasons of all rows, for a figure.
        """
        summary = Summary(self.settings["solutions"])
        kept: dict[str, list[np.ndarray]] = {}
        with joint_writer(output, self.robot, force=force, folder=run.folder) as writer:
            for index in sorted(run.finished):
                columns = run.load(index)
                summary.add(columns, columns.pop(HIDDEN))
                writer.append(columns)
                if keep is not None:
                    for name in ("position_error_m", "rotation_error_rad", "steps", "reason"):
                        kept.setdefault(name, []).append(
                            decoded(columns[name], REASONS) if name == "reason" else columns[name]
                        )
        if keep is not None:
            keep.update({name: np.concatenate(parts) for name, parts in kept.items()})
        return summary


@contextlib.contextmanager
def keeping(run: PartialRun, *, keep_on_error: bool) -> Iterator[None]:
    """Ctrl-C and a failing disk leave the finished parts, and say so; so do other errors if asked to.

    An error in the input removes them: the input has to change, and then they fit no more.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted; {_what_is_kept(run)}") from None
    except IkgradError:
        if not keep_on_error:
            run.discard()
        raise
    except OSError as error:
        raise DataError(f"{describe(error)}; {_what_is_kept(run)}") from error


def _what_is_kept(run: PartialRun) -> str:
    if run.finished:
        return f"finished parts are kept in {run.folder}, the same command with --resume goes on from there"
    run.discard()
    return "nothing was written"


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]
