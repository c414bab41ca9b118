"""What a peer is: another package behind one small class."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import IkgradError
from ikgrad.kinematics import plain_forward_kinematics
from ikgrad.robot import Robot

FK_TOLERANCE = 1e-9  # a peer's forward kinematics must equal ours to this, or it solves another robot


class UnsupportedError(IkgradError, ValueError):
    """A peer cannot do this robot or this job; the message is the reason that tables show."""


@dataclass(frozen=True)
class Question:
    """What a solver is asked, apart from the poses.

    Attributes:
        tol_pos: [m]
        tol_rot: [rad]
        timeout: cap on the time of one pose [s], for solvers that take one; None for none.
        threads: threads a solver may use.
        seed: of random starts.
    """

    tol_pos: float = 1e-6
    tol_rot: float = 1e-6
    timeout: float | None = None
    threads: int = 1
    seed: int = 0


class Peer:
    """Base of the adapters. `prepare` is not timed; `solve`, `fk` and `jacobian` are.

    Attributes:
        name: what tables and ``--peers`` call it.
        package: distribution whose version is told.
        module: what is imported.
        jobs: which of ik, fk, fk_backward, jacobian it can do.
        batched: True if it takes many poses in one call, False if the adapter loops.
        settings: how it is run, in words, for the table's foot.
    """

    name = ""
    package = ""
    module = ""
    jobs: frozenset[str] = frozenset({"ik"})
    batched = False
    settings = ""

    @property
    def version(self) -> str:
        """Version of the package."""
        return importlib.metadata.version(self.package)

    @classmethod
    def installed(cls) -> bool:
        """True if the package is there."""
        try:
            return importlib.util.find_spec(cls.module) is not None
        except ModuleNotFoundError:
            return False

    def available(self, robot: Robot, job: str = "ik") -> str | None:
        """Why it cannot do this job for this robot, or None if it can."""
        if job not in self.jobs:
            return f"no {job} to compare"
        if not self.installed():
            return "not installed; pip install 'ikgrad[bench]'"
        try:
            self.check(robot)
        except UnsupportedError as error:
            return str(error)
        return None

    def check(self, robot: Robot) -> None:
        """Raise `UnsupportedError` if this robot is not for it; cheap."""

    def prepare(self, robot: Robot, question: Question) -> None:
        """Build the robot in the peer's own terms."""
        raise NotImplementedError

    def solve(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """(B, 4, 4) poses and (B, n) starts, or None for cold ones -> (B, n) joints, NaN where it found none."""
        return np.stack([self.solve_one(t, None if q0 is None else q0[k]) for k, t in enumerate(T)])

    def solve_one(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """(4, 4) pose and (n,) start, or None -> (n,) joints, NaN if it found none. One of the two is overridden."""
        return self.solve(T[None], None if q0 is None else q0[None])[0]

    def fk(self, q: np.ndarray) -> np.ndarray:
        """(B, n) -> (B, 4, 4)."""
        raise NotImplementedError

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(B, n) -> (B, 6, n) in the base frame, [linear; angular]."""
        raise NotImplementedError

    def fk_backward(self, q: np.ndarray) -> np.ndarray:
        """(B, n) -> (B, n) gradient of the sum of all elements of the poses, computed forward and backward."""
        raise NotImplementedError


def foreign(module: str) -> Any:
    """Import a peer's module; its own warnings are not ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(module)


def check_same_robot(peer: Peer, robot: Robot) -> None:
    """Refuse a peer whose forward kinematics differs from ours: the comparison would be about another robot."""
    low, high = robot.sampling_range
    q = low + torch.rand(16, robot.dof, dtype=torch.float64, generator=torch.Generator().manual_seed(7)) * (high - low)
    theirs = torch.from_numpy(np.array(peer.fk(q.numpy())))
    worst = float((theirs - plain_forward_kinematics(robot, q)).abs().max())
    if not worst <= FK_TOLERANCE:
        raise UnsupportedError(f"its forward kinematics differs from ours by {worst:.1g}")


def as_array(x: Tensor) -> np.ndarray:
    """A tensor as float64 numpy array."""
    return x.detach().double().numpy()
