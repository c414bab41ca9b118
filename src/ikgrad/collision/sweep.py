"""Does a motion touch an obstacle between its samples? A proof, by bounds on how fast the arm can be."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ikgrad.collision.checks import check_link_radius, check_positive
from ikgrad.collision.links import link_pairs, link_segments
from ikgrad.collision.motions import Motion
from ikgrad.collision.obstacles import Obstacles
from ikgrad.collision.reach import Reach, link_reach
from ikgrad.collision.verdict import MotionCheck
from ikgrad.errors import ShapeError
from ikgrad.robot import Robot

_BLOCK = 2_000_000  # distances in memory at a time
_ROUNDING = 1e-12  # of the arm's length: distances that small prove nothing


class _Intervals(NamedTuple):
    """M intervals of time, with the distances at both ends."""

    row: Tensor  # (M,)
    t0: Tensor  # (M,)
    t1: Tensor  # (M,)
    q0: Tensor  # (M, n)
    q1: Tensor  # (M, n)
    d0: Tensor  # (M, L, K)
    d1: Tensor  # (M, L, K)

    def at(self, index: Tensor | slice) -> _Intervals:
        return _Intervals(*(x[index] for x in self))


@torch.no_grad()
def check_motion(
    robot: Robot, motion: Motion, obstacles: Obstacles, *, link_radius: Tensor | float = 0.0, tol: float = 1e-3
) -> MotionCheck:
    """Prove for every motion of a batch that the arm touches no obstacle, or find where it does.

    Between two times t0 and t1 a point of link l moves by no more than V_l h, with h = t1 - t0 and

        V_l = sum_j |qd_j|_max rho_jl,

    rho_jl the farthest that a point of the link can be from the axis of joint j (see `ikgrad.collision.reach`). So if

        d(t0) + d(t1) > V_l h    for the distances d of every link and obstacle,

    the arm is free in between. Otherwise the interval is cut in two, until it is proven free, or an end touches
    (d <= 0), or V_l h <= ``tol``. Then d is at most tol / 2 at one of its ends, and the motion counts as not free:
    that is the only source of false alarms. Nothing is missed: ``free`` is a proof, up to the rounding of 1e-12 of the
    arm's length (and joint steps below 1e-6 at the breaks of a `PolynomialMotion`).

    Args:
        robot: the robot, n joint variables.
        motion: B motions: `PolynomialMotion`, `FunctionMotion`, `SampledMotion`, or what looks like them.
        obstacles: K `Spheres` or `Capsules`, the same for all motions; they stand still.
        link_radius: radius of the links as capsules [m], one for all or (L,).
        tol: resolution [m]; halving it may double the work for motions that graze an obstacle.

    Returns:
        A `MotionCheck` with the batch shape of the motions.

    Raises:
        ShapeError: the motion has another number of joints, or obstacles have batch dimensions.
        ConfigError: ``tol`` or ``link_radius`` makes no sense, or a function of the motion returns NaN.

    Example:
        >>> import ikgrad as ik, torch
        >>> from ikgrad.collision import PolynomialMotion, Spheres, check_motion
        >>> robot = ik.load_robot("panda")
        >>> q = robot.q_min.lerp(robot.q_max, 0.5)
        >>> turn = torch.stack([q, torch.eye(7)[0]])[None]  # joint 1 at 1 rad/s
        >>> ball = Spheres(torch.tensor([[0.3, 0.3, 0.6]]), torch.tensor([0.1]))
        >>> check = check_motion(robot, PolynomialMotion(torch.tensor([0.0, 1.0]), turn), ball, link_radius=0.05)
        >>> check.touches.item(), round(check.time.item(), 2), check.names[check.link]
        (True, 0.56, ('panda_link4', 'panda_link5'))
    """
    check_positive("tol", tol)
    names = link_pairs(robot)
    check_link_radius(link_radius, len(names))
    if obstacles.radii.ndim != 1:
        raise ShapeError(f"check_motion wants the same K obstacles for all motions, got {tuple(obstacles.radii.shape)}")
    sweep = _Sweep(robot, motion, obstacles, link_radius, tol)
    per_row = (motion.breaks.shape[1] - 1) * len(names) * len(obstacles)
    for rows in torch.arange(len(motion.breaks), device=motion.breaks.device).split(max(1, _BLOCK // per_row)):
        sweep.run(rows)
    return sweep.verdict(names, motion.shape)


class _First:
    """The first time at which something happened in each of B motions, and where."""

    def __init__(self, like: Tensor) -> None:
        self.time = torch.full_like(like, torch.inf)
        self.place = torch.full_like(like, -1, dtype=torch.int64)  # link * K + obstacle

    def report(self, row: Tensor, t: Tensor, place: Tensor) -> None:
        """It happened in motions ``row`` at times ``t``, all (M,)."""
        before = self.time.clone()
        self.time.scatter_reduce_(0, row, t, "amin")
        first = (t == self.time[row]) & (t < before[row])
        self.place[row[first]] = place[first]


class _Sweep:
    """The state of a check: what is known about each of B motions so far."""

    def __init__(
        self, robot: Robot, motion: Motion, obstacles: Obstacles, link_radius: Tensor | float, tol: float
    ) -> None:
        self.robot, self.motion, self.obstacles, self.link_radius, self.tol = robot, motion, obstacles, link_radius, tol
        self.start = motion.breaks[:, 0]
        self.reach: Reach = link_reach(robot.to(self.start.device))
        self.rounding = _ROUNDING * robot.length
        self.contact, self.doubt = _First(self.start), _First(self.start)
        self.clearance = torch.full_like(self.start, torch.inf)
        self.samples = torch.zeros_like(self.contact.place)

    def run(self, rows: Tensor) -> None:
        """Decide some motions: a stack of blocks of intervals, earlier times on top."""
        stack = [self._first(rows)]
        limit = max(1, _BLOCK // stack[0].d0[0].numel())
        while stack:
            block = self._undecided(stack.pop())
            if len(block.row) > limit:
                half = len(block.row) // 2
                stack += [block.at(slice(half, None)), block.at(slice(half))]
            elif len(block.row):
                stack.append(self._halved(block))

    def verdict(self, names: tuple[tuple[str, str], ...], shape: torch.Size) -> MotionCheck:
        """What came out."""
        touches, count = self.contact.time.isfinite(), len(self.obstacles)
        time = self.contact.time.where(touches, self.doubt.time)
        place = self.contact.place.where(touches, self.doubt.place)
        free = time.isinf()
        link, obstacle = (torch.where(free, -1, x) for x in (place // count, place % count))
        fields = (free, touches, time, link, obstacle, self.clearance, self.samples, self.start)
        free, touches, time, link, obstacle, clearance, samples, start = (x.reshape(shape) for x in fields)
        return MotionCheck(free, touches, time, link, obstacle, clearance, samples, start, names)

    def _look(self, row: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        """(M, n) joints and (M, L, K) distances at times, taken into account."""
        q = self.motion.position(row, t)
        if q.shape[-1] != self.robot.dof:
            raise ShapeError(f"robot '{self.robot.name}' has {self.robot.dof} joints, the motion {q.shape[-1]}")
        distance = self.obstacles.distance(link_segments(self.robot, q), self.link_radius)
        least, place = distance.flatten(1).min(dim=1)
        self.samples.index_add_(0, row, torch.ones_like(row))
        self.clearance.scatter_reduce_(0, row, least, "amin")
        hit = torch.nonzero(least <= 0).flatten()
        self.contact.report(row[hit], t[hit], place[hit])
        return q, distance

    def _first(self, rows: Tensor) -> _Intervals:
        """All intervals between breaks."""
        t = self.motion.breaks[rows]  # (R, k)
        count = t.shape[1]
        q, d = self._look(rows.repeat_interleave(count), t.flatten())
        q, d = q.unflatten(0, t.shape), d.unflatten(0, t.shape)
        row = rows[:, None].expand(-1, count - 1)
        parts = (row, t[:, :-1], t[:, 1:], q[:, :-1], q[:, 1:], d[:, :-1], d[:, 1:])
        return _Intervals(*(x.flatten(0, 1) for x in parts))

    def _undecided(self, block: _Intervals) -> _Intervals:
        """Drop what is proven, what comes after the first contact, and what is too short to matter."""
        block = block.at(block.t0 < self.contact.time[block.row])
        h = block.t1 - block.t0
        qd = self.motion.speed(block.row, block.t0, block.t1)
        q = torch.maximum(block.q0.abs(), block.q1.abs()) + qd * h[:, None]
        moves = self.reach.speed(qd, q) * (h * (1 + 1e-9))[:, None]  # (M, L) [m]
        unproven = (block.d0 + block.d1).amin(dim=-1) <= moves + self.rounding
        fine = unproven & (moves <= self.tol)
        middle = (block.t0 + block.t1) / 2
        settled = fine.any(dim=-1) | (middle <= block.t0) | (middle >= block.t1)
        left = unproven.any(dim=-1)
        if not self.motion.continuous:
            settled = left
        self._settle(block.at(left & settled))
        return block.at(left & ~settled)

    def _settle(self, block: _Intervals) -> None:
        """Intervals that cannot be told free: the nearer end stands for each."""
        least0, place0 = block.d0.flatten(1).min(dim=1)
        least1, place1 = block.d1.flatten(1).min(dim=1)
        sooner = least0 <= least1
        self.doubt.report(block.row, block.t0.where(sooner, block.t1), place0.where(sooner, place1))

    def _halved(self, block: _Intervals) -> _Intervals:
        t = (block.t0 + block.t1) / 2
        q, d = self._look(block.row, t)
        first = block._replace(t1=t, q1=q, d1=d)
        second = block._replace(t0=t, q0=q, d0=d)
        return _Intervals(*(torch.cat(pair) for pair in zip(first, second, strict=True)))
