"""Five kinds of closed path inside the cube of +-5 cm about home, gripper straight down, for the closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.data import Samples, Scheme
from ikgrad.errors import UnknownNameError
from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.denso.arm import HOME, tool_down_ik
from ikgrad.robot import Robot

CENTRE = (0.21, 0.0, 0.24)  # [m] the gripper at home
HALF_WIDTH = 0.05  # [m] every path touches all six faces of this cube
LAP = 4000  # ticks; every path is closed
CYCLES = (3, 5, 4)  # of the training path in x, y, z, on a lap
_WAVES, _TURNS = 6, 6


def helix(s: Tensor, seed: int) -> Tensor:
    """Six turns of constant pitch about a vertical axis, three of them up and three down."""
    return torch.stack([(_TURNS * s).sin(), (_TURNS * s).cos(), _triangle(s)], dim=-1)


def square(s: Tensor, seed: int) -> Tensor:
    """Four straight edges with sharp corners; the plane is tilted, so that the corners are corners of the cube."""
    x, y = _trapezoid(s), _trapezoid(s + math.pi / 2)
    return torch.stack([x, y, x], dim=-1)


def figure_eight(s: Tensor, seed: int) -> Tensor:
    """An eight in x and y that rises and falls three times a lap."""
    return torch.stack([(2 * s).sin(), s.sin(), (3 * s).sin()], dim=-1)


def random_smooth(s: Tensor, seed: int) -> Tensor:
    """Six waves with random amplitudes and phases in every coordinate."""
    generator = torch.Generator().manual_seed(seed)
    phase = 2 * math.pi * torch.rand(3, _WAVES, dtype=torch.float64, generator=generator)
    size = torch.randn(3, _WAVES, dtype=torch.float64, generator=generator)
    unit = (size * torch.sin(s[:, None, None] * torch.arange(1, _WAVES + 1) + phase)).sum(-1)
    return unit / unit.abs().amax(0)


def training_path(s: Tensor, seed: int) -> Tensor:
    """One wave in every coordinate, phases drawn: the path on which the networks of scheme B are trained."""
    generator = torch.Generator().manual_seed(seed)
    phase = 2 * math.pi * torch.rand(3, dtype=torch.float64, generator=generator)
    return torch.sin(s[:, None] * torch.tensor(CYCLES) + phase)


PATHS: dict[str, Callable[[Tensor, int], Tensor]] = {
    "helix": helix,
    "square": square,
    "figure eight": figure_eight,
    "random smooth": random_smooth,
    "training path": training_path,
}


def path_points(kind: str, *, seed: int = 0, lap: int = LAP) -> Tensor:
    """(lap, 3) one lap of a path [m]; the point after the last one is the first.

    Args:
        kind: a key of `PATHS`.
        seed: of the random smooth path and of the training path; the others are the same for every seed.
        lap: points.

    Raises:
        UnknownNameError: no such path.

    Example:
        >>> p = path_points("helix")
        >>> [round(x, 3) for x in p[0].tolist()]
        [0.21, 0.05, 0.19]
    """
    if kind not in PATHS:
        raise UnknownNameError("path", kind, PATHS)
    s = 2 * math.pi * torch.arange(lap, dtype=torch.float64) / lap
    return torch.tensor(CENTRE, dtype=torch.float64) + HALF_WIDTH * PATHS[kind](s, seed)


def all_paths(seed: int, *, lap: int = LAP) -> Tensor:
    """(5, lap, 3) one lap of every path, in the order of `PATHS` [m]."""
    return torch.stack([path_points(kind, seed=seed, lap=lap) for kind in PATHS])


def down(p: Tensor) -> Tensor:
    """(..., 4, 4) poses at positions (..., 3) [m], gripper straight down."""
    T = torch.diag(p.new_tensor([-1.0, 1.0, -1.0, 1.0])).expand(*p.shape[:-1], 4, 4).clone()
    T[..., :3, 3] = p
    return T


@dataclass(frozen=True)
class TrainingPath(Scheme):
    """Scheme B in the cube: the training path, present joints those of the point before, perhaps with noise.

    Attributes:
        noise: half width of uniform noise on the present joints [rad].
    """

    NAME = "denso_training_path"

    home: tuple[float, ...] = HOME
    noise: float = 0.0

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """One lap, in order; the phases are those of ``seed``, whatever has been drawn before."""
        q = tool_down_ik(path_points("training path", seed=self.seed, lap=self.count))
        unit = 2 * torch.rand(q.shape, dtype=torch.float64, generator=generator) - 1
        return Samples(forward_kinematics(robot, q), q, q.roll(1, 0) + self.noise * unit)


def _triangle(s: Tensor) -> Tensor:
    """A wave of straight lines, -1 at 0 and 1 at pi."""
    return 1 - 2 / math.pi * (torch.remainder(s, 2 * math.pi) - math.pi).abs()


def _trapezoid(s: Tensor) -> Tensor:
    """A triangle of twice the height, cut at -1 and 1: a quarter of the lap each at the bottom, up, top, down."""
    return (2 * _triangle(s)).clamp(-1, 1)


__all__ = [
    "CENTRE",
    "HALF_WIDTH",
    "LAP",
    "PATHS",
    "TrainingPath",
    "all_paths",
    "down",
    "path_points",
]
