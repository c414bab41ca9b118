"""Exceptions. Each derives from `IkgradError` and from the built-in that it resembles."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ikgrad.collision.verdict import MotionCheck
    from ikgrad.planning.result import OptimizedTrajectory
    from ikgrad.solvers.solution import IKSolution


class IkgradError(Exception):
    """Base of all errors that this package raises on purpose."""


class ShapeError(IkgradError, ValueError):
    """An array has the wrong shape or dtype."""


class UnknownNameError(IkgradError, LookupError):
    """No robot, link, joint or method has this name."""

    def __init__(self, kind: str, name: str, known: Iterable[str]):
        known = list(known)
        close = [word for word in known if word.lower() == name.lower()]
        close = close or difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        shown = ", ".join(known[:30]) + (f", ... ({len(known)} in all)" if len(known) > 30 else "")
        super().__init__(f"unknown {kind} '{name}'{hint} (known: {shown})")


class RobotError(IkgradError, ValueError):
    """A robot description cannot be used; the message names the file, the joint and the reason."""


class ConfigError(IkgradError, ValueError):
    """A setting or a configuration file is wrong; the message names the key and what is allowed."""


class DataError(IkgradError, ValueError):
    """A data file cannot be read or written; the message names the file and the place in it."""


class MissingExtraError(IkgradError, ImportError):
    """A feature needs a package that is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, package: str, extra: str):
        super().__init__(f"{what} need {package}; pip install 'ikgrad[{extra}]'", name=package)
        self.extra = extra


class ConvergenceError(IkgradError, RuntimeError):
    """Raised by `IKSolution.raise_if_failed`; carries the solution as ``solution``."""

    def __init__(self, message: str, solution: IKSolution):
        super().__init__(message)
        self.solution = solution


class TrainingError(IkgradError, RuntimeError):
    """A training cannot go on; the message says at which epoch, and the last good weights are in the network."""


class CollisionError(IkgradError, RuntimeError):
    """Raised by `MotionCheck.raise_if_touching`; carries the verdicts as ``check``."""

    def __init__(self, message: str, check: MotionCheck):
        super().__init__(message)
        self.check = check


class PlanningError(IkgradError, RuntimeError):
    """Raised by `OptimizedTrajectory.raise_if_failed`; carries the trajectories as ``result``."""

    def __init__(self, message: str, result: OptimizedTrajectory):
        super().__init__(message)
        self.result = result


def describe(error: OSError) -> str:
    """What the system says, with the file that it says it of."""
    reason = error.strerror or str(error)
    return f"{error.filename}: {reason}" if error.filename else f"cannot write: {reason}"
