"""Sampling schemes: how joints, poses and *present* joints of a data set come about.

A feedback inverter also sees the joints of a moment ago; where those come from decides what it learns. Every scheme is
a frozen record of numbers around a home configuration, within one branch of solutions; `draw` makes samples of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, NoReturn

import torch
from torch import Tensor

from ikgrad.errors import ConfigError, DataError
from ikgrad.kinematics import forward_kinematics
from ikgrad.robot import Robot
from ikgrad.solvers.solve import solve_ik

_EXACT = 1e-12  # [m], [rad]: what is left of the error of a pose found by IK
_JUMP = 1.0  # [rad or m]: neighbours on one branch are nearer in every joint


class Samples(NamedTuple):
    """Rows to learn from.

    Attributes:
        T: (N, 4, 4) poses, exactly those of ``q`` [m].
        q: (N, n) joint values that are wanted [rad or m].
        q_current: (N, n) joints at which the arm stands when it is asked.
    """

    T: Tensor
    q: Tensor
    q_current: Tensor

    def rows(self, index: Tensor) -> Samples:
        """Some of the rows."""
        return Samples(*(part[index] for part in self))


@dataclass(frozen=True)
class Scheme:
    """What all schemes share.

    Attributes:
        home: (n,) the middle of it all [rad or m]; empty: the middle of the joint range.
        count: rows.
        seed: of everything that is drawn.
    """

    NAME: ClassVar[str]

    home: tuple[float, ...] = ()
    count: int = 4000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.count < 1:
            raise DataError(f"count must be at least 1, got {self.count}; an empty data set teaches nothing")
        for key, value in vars(self).items():
            for number in value if isinstance(value, tuple) else (value,):
                if not abs(number) < float("inf"):
                    raise ConfigError(f"{key} must be finite, got {number}")

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """The rows; ``generator`` is asked for every random number."""
        raise NotImplementedError

    def _home(self, robot: Robot) -> Tensor:
        low, high = (limit.to("cpu", torch.float64) for limit in robot.sampling_range)
        home = torch.tensor(self.home, dtype=torch.float64) if self.home else (low + high) / 2
        if home.shape != (robot.dof,):
            raise ConfigError(f"home must hold {robot.dof} values for robot '{robot.name}', got {len(self.home)}")
        return home


@dataclass(frozen=True)
class JointBox(Scheme):
    """Scheme A: joints independently uniform in a box about home, present joints those plus uniform noise.

    Attributes:
        half_width: of the box, the same for every joint [rad or m].
        noise: half width of the noise on the present joints [rad or m].

    Example:
        >>> import ikgrad as ik
        >>> data = ik.data.generate(ik.load_robot("ur5e"), JointBox(count=100, half_width=0.2, noise=0.01))
        >>> bool((data.samples.q - data.samples.q_current).abs().max() <= 0.01)
        True
    """

    NAME = "joint_box"

    half_width: float = 0.2
    noise: float = 0.02

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """The rows."""
        q = self._home(robot) + self.half_width * _symmetric(self.count, robot.dof, generator)
        q_current = q + self.noise * _symmetric(self.count, robot.dof, generator)
        return Samples(forward_kinematics(robot, q), q, q_current)


@dataclass(frozen=True)
class SmoothPath(Scheme):
    """Scheme B: one smooth path in joint space, present joints those of the sample before.

    ``q_j(k) = home_j + amplitude sin(2 pi cycles_j k / (count + 1) + phase_j)``, k = 0 ... count, phases drawn. Rows
    come in the order of the path.

    Attributes:
        amplitude: of every joint [rad or m].
        cycles: of every joint over the whole path; the last one goes on for further joints.
        noise: half width of uniform noise on the present joints, which the network learns to correct [rad or m].

    Example:
        >>> import ikgrad as ik
        >>> path = ik.data.generate(ik.load_robot("denso_vp6242"), SmoothPath(count=500)).samples
        >>> bool((path.q_current[1:] == path.q[:-1]).all())
        True
    """

    NAME = "smooth_path"

    amplitude: float = 0.17453292519943295  # 10 degrees
    cycles: tuple[float, ...] = (3.0, 5.0, 4.0, 6.0, 7.0, 2.0)
    noise: float = 0.0

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """The rows."""
        if not self.cycles:
            raise ConfigError("cycles must hold at least one number")
        phases = 2 * torch.pi * torch.rand(robot.dof, dtype=torch.float64, generator=generator)
        share = torch.arange(self.count + 1, dtype=torch.float64) / (self.count + 1)
        numbers = [self.cycles[min(j, len(self.cycles) - 1)] for j in range(robot.dof)]
        cycles = torch.tensor(numbers, dtype=torch.float64)
        q = self._home(robot) + self.amplitude * torch.sin(2 * torch.pi * share[:, None] * cycles + phases)
        q_current = q[:-1] + self.noise * _symmetric(self.count, robot.dof, generator)
        return Samples(forward_kinematics(robot, q[1:]), q[1:], q_current)


@dataclass(frozen=True)
class Helix(Scheme):
    """Scheme C: a helix of positions with the orientation of home, present joints those of the sample before.

    ``p(s) = c + (radius_x sin 2 pi turns s, radius_y cos 2 pi turns s, rise (s - 1/2))``, s from 0 to 1, about a
    vertical axis. Joints come from `solve_ik`, started at home and exact to 1e-12; nothing is drawn.

    Attributes:
        centre: of the helix [m]; empty: the position at home.
        radius_x: [m]
        radius_y: [m]
        rise: from the first point to the last [m].
        turns: number of turns.

    Example:
        >>> import ikgrad as ik
        >>> scheme = Helix(home=(0.0, 1.57, 3.14, 0.0, -1.57, 0.0), count=200)
        >>> data = ik.data.generate(ik.load_robot("denso_vp6242"), scheme)
        >>> round(float(data.samples.T[:, 2, 3].max() - data.samples.T[:, 2, 3].min()), 4)
        0.0796
    """

    NAME = "helix"

    centre: tuple[float, ...] = ()
    radius_x: float = 0.06
    radius_y: float = 0.06
    rise: float = 0.08
    turns: float = 3.0

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """The rows."""
        home = self._home(robot)
        s = torch.arange(self.count + 1, dtype=torch.float64) / self.count
        angle = 2 * torch.pi * self.turns * s
        p = torch.stack([self.radius_x * angle.sin(), self.radius_y * angle.cos(), self.rise * (s - 0.5)], dim=-1)
        p = _centre(robot, home, self.centre) + p
        q, reached = _solve(robot, p, home)
        if not reached.all():
            _refuse_unreached(robot, p[~reached], p, self.NAME)
        _refuse_jumps(q[1:], q[:-1], self.NAME)
        return Samples(forward_kinematics(robot, q[1:]), q[1:], q[:-1])


@dataclass(frozen=True)
class Cube(Scheme):
    """Scheme D: positions uniform in a cube with the orientation of home, present joints those of a point nearby.

    The nearby point lies in a random direction, at a distance uniform in a range, and may lie outside the cube. Joints
    come from `solve_ik`, started at home and exact to 1e-12.

    Attributes:
        centre: of the cube [m]; empty: the position at home.
        half_width: of the cube [m].
        nearest: least distance of the nearby point [m].
        farthest: largest distance [m].
        redraw: draw points out of reach anew (the cube is then not filled evenly) instead of refusing the cube.

    Example:
        >>> import ikgrad as ik
        >>> scheme = Cube(home=(0.0, 1.57, 3.14, 0.0, -1.57, 0.0), count=200, half_width=0.03)
        >>> data = ik.data.generate(ik.load_robot("denso_vp6242"), scheme)
        >>> bool((data.samples.T[:, :3, 3] - data.samples.T[:, :3, 3].mean(0)).abs().max() < 0.04)
        True
    """

    NAME = "cube"

    centre: tuple[float, ...] = ()
    half_width: float = 0.05
    nearest: float = 0.0005
    farthest: float = 0.010
    redraw: bool = False

    def draw(self, robot: Robot, generator: torch.Generator) -> Samples:
        """The rows."""
        if not 0 <= self.nearest <= self.farthest:
            raise ConfigError(f"nearest must be between 0 and farthest, {self.farthest}, got {self.nearest}")
        home = self._home(robot)
        kept: list[Tensor] = []  # (k, 2, n) each
        while sum(map(len, kept)) < self.count:
            p = self._points(_centre(robot, home, self.centre), generator)  # (count, 2, 3)
            q, reached = _solve(robot, p, home)
            good = reached.all(-1)
            if not good.all() and not (self.redraw and good.any()):
                _refuse_unreached(robot, p[~reached], p, self.NAME)
            kept.append(q[good])
        q, q_current = torch.cat(kept)[: self.count].unbind(1)
        _refuse_jumps(q, q_current, self.NAME)
        return Samples(forward_kinematics(robot, q), q, q_current)

    def _points(self, centre: Tensor, generator: torch.Generator) -> Tensor:
        """(count, 2, 3) points and the points nearby."""
        p = centre + self.half_width * _symmetric(self.count, 3, generator)
        direction = torch.randn(self.count, 3, dtype=torch.float64, generator=generator)
        share = torch.rand(self.count, 1, dtype=torch.float64, generator=generator)
        distance = self.nearest + share * (self.farthest - self.nearest)
        return torch.stack([p, p + distance * direction / direction.norm(dim=-1, keepdim=True)], dim=1)


SCHEMES: dict[str, type[Scheme]] = {scheme.NAME: scheme for scheme in (JointBox, SmoothPath, Helix, Cube)}


def _symmetric(rows: int, columns: int, generator: torch.Generator) -> Tensor:
    """Uniform in [-1, 1)."""
    return 2.0 * torch.rand(rows, columns, dtype=torch.float64, generator=generator) - 1.0


def _centre(robot: Robot, home: Tensor, centre: tuple[float, ...]) -> Tensor:
    if not centre:
        return forward_kinematics(robot, home)[:3, 3]
    if len(centre) != 3:
        raise ConfigError(f"centre must hold three coordinates [m], got {len(centre)}")
    return torch.tensor(centre, dtype=torch.float64)


def _solve(robot: Robot, p: Tensor, home: Tensor) -> tuple[Tensor, Tensor]:
    """Joints that reach positions (..., 3) with the orientation of home, on its branch; and which of them do."""
    T = forward_kinematics(robot, home).expand(*p.shape[:-1], 4, 4).clone()
    T[..., :3, 3] = p
    solution = solve_ik(robot, T, q0=home, tol_pos=_EXACT, tol_rot=_EXACT)
    return solution.q.detach(), solution.success


def _refuse_unreached(robot: Robot, lost: Tensor, p: Tensor, scheme: str) -> NoReturn:
    where = ", ".join(f"{x:.4g}" for x in lost[0].tolist())
    raise DataError(
        f"{scheme}: {len(lost)} of {p.numel() // 3} points cannot be reached by robot '{robot.name}' with the "
        f"orientation of home, the first at ({where}) m; make it smaller or move its centre"
    )


def _refuse_jumps(q: Tensor, q_current: Tensor, scheme: str) -> None:
    """Neighbours that are far apart lie on different branches, and their mean, which a network would learn, on none."""
    step = (q - q_current).abs().amax()
    if step > _JUMP:
        raise DataError(
            f"{scheme}: joints of neighbouring points differ by up to {step.item():.2f}; the points reach into "
            "another branch of solutions. Make it smaller or move it away from the edge of the workspace"
        )


__all__ = ["SCHEMES", "Cube", "Helix", "JointBox", "Samples", "Scheme", "SmoothPath"]
