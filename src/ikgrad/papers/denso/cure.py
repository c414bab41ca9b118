"""The closed loop cured: every remedy trained over seeds, and fed with its own answers on five kinds of path.

Why an answer that is fed back goes astray: an error e of the present joints comes back as K e, with the network's
K = dq_out/dq_current, and its own one-step error d is added, ``e' = K e + d``. With all eigenvalues of K well inside
the unit circle e stays near ``(I - K)^-1 d``; with one outside it grows until the network is lost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ikgrad.data import SmoothPath
from ikgrad.kinematics import forward_kinematics
from ikgrad.networks import Inverter
from ikgrad.papers.denso.arm import HOME, denso, tool_down_ik
from ikgrad.papers.denso.candidates import NOISES_DEG, SMALL, Candidate, Trained, cube_remedies, path_remedies
from ikgrad.papers.denso.loop import closed_loop, gains, position
from ikgrad.papers.denso.networks import Counter
from ikgrad.papers.denso.paths import LAP, all_paths, down
from ikgrad.training.inverters import mean_squared_error

SPEEDS = (LAP, LAP // 10, LAP // 40)  # ticks a lap


@dataclass(frozen=True)
class LoopRow:
    """One remedy in closed loop, S networks on five paths each.

    Attributes:
        remedy: what was done.
        data: what it was trained on.
        hidden: units; 0: no network.
        seconds: of the training of all S, and of one tick of one arm.
        mse: (S,) one step, true present joints given, over all paths [rad^2]; empty without a network.
        gain: (S,) largest spectral radius of dq_out/dq_current along the paths; empty without a
            network.
        worst_mm: (S, 5) largest position error on each path [mm].
        drift_mm: (S,) largest error of the last lap less that of the first [mm].
    """

    remedy: str
    data: str
    hidden: int
    seconds: tuple[float, float]
    mse: Tensor
    gain: Tensor
    worst_mm: Tensor
    drift_mm: Tensor


@dataclass(frozen=True)
class SpeedRow:
    """The recommended network, or one step, or both, on paths of few points.

    Attributes:
        what: follows the path.
        worst_mm: one (S,) for each of `SPEEDS`, over all paths [mm].
    """

    what: str
    worst_mm: tuple[Tensor, ...]


@dataclass(frozen=True)
class NoiseRow:
    """Scheme B of the paper's study, the smooth path of all joints, with noise on the present joints.

    Attributes:
        noise_deg: half width of the noise.
        mse: (S,) on the test rows, present joints with the same noise [rad^2].
        worst_mm: (S,) closed loop on its own path [mm].
    """

    noise_deg: float
    mse: Tensor
    worst_mm: Tensor


@dataclass(frozen=True)
class CureStudy:
    """All of it.

    Attributes:
        rows: the remedies; the recommended network is ``best``, with a correction ``corrected``.
        best: place of the recommended network.
        corrected: place of that with one correction a tick.
        speeds: what is left of it on coarse paths.
        noise: scheme B of all joints with noise.
        ticks: of every closed loop.
        epochs: of every remedy.
        final_epochs: of the recommended network.
    """

    rows: tuple[LoopRow, ...]
    best: int
    corrected: int
    speeds: tuple[SpeedRow, ...]
    noise: tuple[NoiseRow, ...]
    ticks: int
    epochs: int
    final_epochs: int


class Course:
    """The paths of S seeds, and the closed loop along them.

    Args:
        seeds: S of them.
        ticks: of a closed loop.
        lap: points of a lap.
    """

    def __init__(self, seeds: Sequence[int], ticks: int, lap: int = LAP):
        self.ticks = ticks
        self.points = torch.stack([all_paths(seed, lap=lap) for seed in seeds])  # (S, 5, L, 3)
        self.T, self.q = down(self.points), tool_down_ik(self.points)

    def errors_mm(self, inverters: Sequence[Inverter], *, corrections: int = 0) -> Tensor:
        """(ticks, S, 5) position errors."""
        q = closed_loop(inverters, self.T, self.q[:, :, -1], ticks=self.ticks, corrections=corrections)
        wanted = self.points.movedim(2, 0)
        found = [(position(lap) - wanted[: len(lap)]).norm(dim=-1) for lap in q.split(len(wanted))]
        return 1000 * torch.cat(found)

    def row(self, candidate: Candidate, *, corrections: int = 0) -> LoopRow:
        """Close the loop of a candidate."""
        remedy, data, inverters, seconds = candidate
        errors = self.errors_mm(inverters, corrections=corrections)
        laps = errors.amax(-1).split(LAP)
        nothing = torch.empty(0, dtype=torch.float64)
        return LoopRow(
            remedy,
            data,
            inverters[0].network.sizes[1] if inverters else 0,
            (seconds, self.seconds(inverters, corrections)),
            self.one_step(inverters) if inverters else nothing,
            self.gain(inverters) if inverters else nothing,
            errors.amax(0),
            laps[-1].amax(0) - laps[0].amax(0),
        )

    @torch.no_grad()
    def one_step(self, inverters: Sequence[Inverter]) -> Tensor:
        """(S,) mean squared error of the joints, true present joints given [rad^2]."""
        parts = []
        for inverter, T, q in zip(inverters, self.T, self.q, strict=True):
            answer = inverter(T, q.roll(1, -2)) if inverter.feedback else inverter(T)
            parts.append((answer - q).square().mean())
        return torch.stack(parts)

    def gain(self, inverters: Sequence[Inverter]) -> Tensor:
        """(S,) largest spectral radius of dq_out/dq_current at every fortieth point."""
        some = slice(None, None, 40)
        return gains(inverters, self.T[:, :, some], self.q.roll(1, 2)[:, :, some]).amax((1, 2))

    def seconds(self, inverters: Sequence[Inverter], corrections: int = 0) -> float:
        """Of a processor, for a tick of one arm: the best of ten, since what else runs here also costs."""
        times = []
        for _ in range(10):
            start = time.process_time()
            closed_loop(inverters[:1], self.T[:1, :1], self.q[:1, :1, -1], ticks=200, corrections=corrections)
            times.append((time.process_time() - start) / 200)
        return min(times)


def cure(
    seeds: Sequence[int],
    epochs: int,
    final_epochs: int,
    ticks: int,
    *,
    count: Counter | None = None,
    checkpoints: Path | None = None,
) -> CureStudy:
    """Train all remedies and close the loop.

    Args:
        seeds: of data, first weights and paths; a network of each remedy for every one.
        epochs: of every remedy.
        final_epochs: of the recommended network.
        ticks: of every closed loop.
        count: called with the number of networks after every epoch.
        checkpoints: folder of checkpoints of the trainings; what is found there is gone on with.

    Raises:
        DataError: a checkpoint is of other settings, or damaged.
    """
    trained = Trained(seeds, epochs, final_epochs, count=count, checkpoints=checkpoints)
    course = Course(seeds, ticks)
    candidates = [*path_remedies(trained), *cube_remedies(trained)]
    plain, best = candidates[0], candidates[-1]
    corrected = [
        plain._replace(remedy="plain, one correction a tick"),
        Candidate("one damped step a tick, no network", "", (), 0.0),
        best._replace(remedy="nearby points, one correction a tick"),
    ]
    rows = [*map(course.row, candidates), *(course.row(candidate, corrections=1) for candidate in corrected)]
    return CureStudy(
        tuple(rows),
        len(candidates) - 1,
        len(rows) - 1,
        _speeds(seeds, ticks, best.inverters),
        _noise(trained),
        ticks,
        epochs,
        final_epochs,
    )


def _speeds(seeds: Sequence[int], ticks: int, best: Sequence[Inverter]) -> tuple[SpeedRow, ...]:
    rows = (("network alone", best, 0), ("one damped step alone", (), 1), ("network and one damped step", best, 1))
    courses = [Course(seeds, min(ticks, 2 * lap), lap) for lap in SPEEDS]
    return tuple(
        SpeedRow(what, tuple(course.errors_mm(who, corrections=k).amax((0, 2)) for course in courses))
        for what, who, k in rows
    )


def _noise(trained: Trained) -> tuple[NoiseRow, ...]:
    rows = []
    for noise in (0.0, *NOISES_DEG):
        data = trained.sets(lambda seed, noise=noise: SmoothPath(home=HOME, seed=seed, noise=math.radians(noise)))  # type: ignore[misc]
        inverters = trained.train(data, SMALL)
        mse = torch.stack([mean_squared_error(i, d.test) for i, d in zip(inverters, data, strict=True)])
        T = torch.stack([d.samples.T for d in data])[:, None]
        start = torch.stack([d.samples.q_current[0] for d in data])[:, None]
        q = closed_loop(inverters, T, start, ticks=T.shape[2])[:, :, 0]
        wanted = torch.stack([forward_kinematics(denso(), d.samples.q)[:, :3, 3] for d in data], dim=1)
        rows.append(NoiseRow(noise, mse, 1000 * (position(q) - wanted).norm(dim=-1).amax(0)))
    return tuple(rows)


__all__ = ["Course", "CureStudy", "LoopRow", "NoiseRow", "SpeedRow", "cure"]
