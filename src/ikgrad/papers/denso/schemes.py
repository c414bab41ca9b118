"""Which sampling makes the paper's claim hold: schemes A, B, C and D, and what the closed loop makes of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ikgrad.data import Cube, Helix, JointBox, Samples, SmoothPath
from ikgrad.networks import Inverter
from ikgrad.papers.denso.arm import HOME
from ikgrad.papers.denso.networks import (
    NAMES,
    Counter,
    NetworkResult,
    answers,
    axis_errors_mm,
    checkpoint_file,
    copy_error,
    make_data,
    train,
)

BOXES_DEG, NOISES_DEG = (5.0, 10.0, 20.0, 30.0), (0.5, 1.0, 2.0, 5.0)
CUBES = (0.03, 0.05, 0.07)  # [m]; the corners of the last two are out of reach
TURNS = (3.0, 10.0)
RADIUS, RISE, TRACK = 0.045, 0.08, 1500  # of the helix that is followed, inside the cube of +-5 cm; points
LOST_MM = 10.0


@dataclass(frozen=True)
class PathStudy:
    """Scheme B over seeds.

    Attributes:
        traditional: its errors.
        feedback: its errors, true present joints given.
        copy_mse: of answering with the present joints, mean over the seeds [rad^2].
        drift_mm: (S,) largest position error of the feedback network in closed loop on its own path [mm].
        lost_at: (S,) first step with more than 10 mm; -1: never.
        drift: (N, S) the error along the path [mm].
    """

    traditional: NetworkResult
    feedback: NetworkResult
    copy_mse: float
    drift_mm: Tensor
    lost_at: Tensor
    drift: Tensor


@dataclass(frozen=True)
class BoxRow:
    """Scheme A in one box.

    Attributes:
        box_deg: half width of the box.
        traditional: mean squared error [rad^2].
        feedback: one for each half width of the noise on the present joints [rad^2].
        copy: of answering with the present joints, one for each [rad^2].
    """

    box_deg: float
    traditional: float
    feedback: tuple[float, ...]
    copy: tuple[float, ...]


@dataclass(frozen=True)
class PairRow:
    """Both networks on one data set of scheme C or D.

    Attributes:
        title: which.
        traditional: mean squared error [rad^2].
        feedback: mean squared error, true present joints given [rad^2].
        copy: of answering with the present joints [rad^2].
    """

    title: str
    traditional: float
    feedback: float
    copy: float


@dataclass(frozen=True)
class TrackStudy:
    """Both networks, trained by scheme D in +-5 cm, on a helix inside the cube.

    Attributes:
        traditional: on its test rows.
        feedback: on its test rows.
        one_step_mm: name to (S, 3), largest error of x, y, z with the true present joints [mm].
        closed_mm: the same with the network's own answers fed back.
        path: (N, 3) the helix [m].
        errors_mm: name to (N, 3), the closed loop of the median seed.
        median_seed: by largest closed-loop error of the feedback network.
    """

    traditional: NetworkResult
    feedback: NetworkResult
    one_step_mm: dict[str, Tensor]
    closed_mm: dict[str, Tensor]
    path: Tensor
    errors_mm: dict[str, Tensor]
    median_seed: int


def scheme_b(
    seeds: int, epochs: tuple[int, int], *, count: Counter | None = None, checkpoints: Path | None = None
) -> PathStudy:
    """One smooth path a seed, cut at given epochs (traditional, feedback)."""
    data = make_data([SmoothPath(home=HOME, seed=seed) for seed in range(seeds)])
    results, nets = {}, {}
    for name, last in zip(NAMES, epochs, strict=True):
        file = checkpoint_file(checkpoints, "scheme_b", name)
        results[name], nets[name] = train(
            name, data, last, seeds=range(seeds), best=False, count=count, checkpoint=file
        )
    drift = torch.stack(
        [_closed_loop_mm(net, d.samples).norm(dim=-1) for net, d in zip(nets["feedback"], data, strict=True)], dim=-1
    )
    lost = drift > LOST_MM
    first = torch.where(lost.any(0), lost.int().argmax(0), -1)
    copies = sum(map(copy_error, data)) / seeds
    return PathStudy(results["traditional"], results["feedback"], copies, drift.amax(0), first, drift)


def scheme_a(epochs: int, *, count: Counter | None = None, checkpoints: Path | None = None) -> tuple[BoxRow, ...]:
    """Joint boxes about home, present joints at several distances; one seed a cell."""
    cells = [(box, noise) for box in BOXES_DEG for noise in NOISES_DEG]
    data = make_data(
        [JointBox(home=HOME, half_width=math.radians(box), noise=math.radians(noise)) for box, noise in cells]
    )
    boxes = data[:: len(NOISES_DEG)]  # the traditional network does not see the noise
    results = {}
    for name, sets in (("feedback", data), ("traditional", boxes)):
        file = checkpoint_file(checkpoints, "scheme_a", name)
        results[name], _ = train(name, sets, epochs, seeds=range(len(sets)), count=count, checkpoint=file)
    feedback, traditional = results["feedback"], results["traditional"]
    rows = []
    for k, box in enumerate(BOXES_DEG):
        part = slice(k * len(NOISES_DEG), (k + 1) * len(NOISES_DEG))
        copies = tuple(map(copy_error, data[part]))
        rows.append(BoxRow(box, traditional.mse[k].item(), tuple(feedback.mse[part].tolist()), copies))
    return tuple(rows)


def schemes_c_and_d(
    epochs: int, *, count: Counter | None = None, checkpoints: Path | None = None
) -> tuple[PairRow, ...]:
    """A helix alone, and cubes with a point nearby; one seed each."""
    titles = [f"C: helix, radius 0.06 m, {turns:g} turns" for turns in TURNS]
    titles += [f"D: cube +-{100 * half:g} cm, present point 0.5-10 mm away" for half in CUBES]
    helices = [Helix(home=HOME, turns=turns) for turns in TURNS]
    cubes = [Cube(home=HOME, half_width=half, redraw=True) for half in CUBES]
    data = make_data([*helices, *cubes])
    mse = {}
    for name in NAMES:
        file = checkpoint_file(checkpoints, "schemes_c_and_d", name)
        result, _ = train(name, data, epochs, seeds=range(len(data)), count=count, checkpoint=file)
        mse[name] = result.mse.tolist()
    both = zip(mse["traditional"], mse["feedback"], map(copy_error, data), strict=True)
    return tuple(PairRow(title, *row) for title, row in zip(titles, both, strict=True))


def track(seeds: int, epochs: int, *, count: Counter | None = None, checkpoints: Path | None = None) -> TrackStudy:
    """Train in the cube of +-5 cm and follow a helix inside it, one-step and in closed loop."""
    data = make_data([Cube(home=HOME, seed=seed, redraw=True) for seed in range(seeds)])
    rows = make_data([Helix(home=HOME, count=TRACK, radius_x=RADIUS, radius_y=RADIUS, rise=RISE)])[0].samples
    results, one_step, loops = {}, {}, {}
    for name in NAMES:
        file = checkpoint_file(checkpoints, "track", name)
        results[name], nets = train(name, data, epochs, seeds=range(seeds), count=count, checkpoint=file)
        one_step[name] = torch.stack([axis_errors_mm(answers(net, rows), rows).abs().amax(0) for net in nets])
        loops[name] = torch.stack([_closed_loop_mm(net, rows) for net in nets])  # (S, N, 3)
    closed = {name: errors.abs().amax(1) for name, errors in loops.items()}
    order = closed["feedback"].amax(-1).argsort()
    middle = int(order[(seeds - 1) // 2])
    picked = {name: errors[middle] for name, errors in loops.items()}
    path = rows.T[:, :3, 3]
    return TrackStudy(results["traditional"], results["feedback"], one_step, closed, path, picked, middle)


def work(seeds: int, epochs: int, path_epochs: Sequence[int]) -> int:
    """Networks times epochs of everything above, for progress."""
    cells = len(BOXES_DEG) * (1 + len(NOISES_DEG)) + 2 * (len(TURNS) + len(CUBES)) + 2 * seeds
    return seeds * sum(path_epochs) + epochs * cells


@torch.no_grad()
def _closed_loop_mm(inverter: Inverter, rows: Samples) -> Tensor:
    """(N, 3) position errors with the inverter's own answers as present joints, the first ones true [mm]."""
    return axis_errors_mm(inverter.rollout(rows.T, rows.q_current[0]), rows)


def percentages(errors_mm: Tensor, path: Tensor) -> dict[str, Tensor]:
    """Largest errors in percent, by the two definitions that the paper's numbers suggest.

    Args:
        errors_mm: (..., 3) largest error of x, y, z [mm].
        path: (N, 3) [m].

    Returns:
        ``"amplitude"``: of half the range of that coordinate; ``"coordinate"``: of its largest absolute value.
    """
    amplitude = (path.amax(0) - path.amin(0)) / 2
    return {
        "amplitude": 0.1 * errors_mm / amplitude,
        "coordinate": 0.1 * errors_mm / path.abs().amax(0),
    }


__all__ = [
    "BOXES_DEG",
    "LOST_MM",
    "NOISES_DEG",
    "BoxRow",
    "PairRow",
    "PathStudy",
    "TrackStudy",
    "percentages",
    "scheme_a",
    "scheme_b",
    "schemes_c_and_d",
    "track",
    "work",
]
