"""The networks that try to stay on their path: every remedy, trained over seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ikgrad.data import Cube, DataSet, Scheme
from ikgrad.networks import Inverter
from ikgrad.papers.denso import remedies
from ikgrad.papers.denso.arm import HOME
from ikgrad.papers.denso.networks import Counter, checkpoint_file, make_data
from ikgrad.papers.denso.paths import TrainingPath
from ikgrad.training.losses import Loss, joint

NOISES_DEG = (0.2, 1.0)
ROUNDS, LONGEST = 3, 20  # of rollouts; ticks
FILLED = 0.055  # [m] half width of the cube of the data; the paths touch the faces of the one of 0.05
NEAR, FAR = 0.002, 0.010  # [m] largest distance of the present point
SMALL, MIDDLE, LARGE = 10, 20, 30  # hidden units
PENALTIES = (1e-3, 1e-2)  # [rad]: of nearby points; of increments


class Candidate(NamedTuple):
    """S networks, and how they came about.

    Attributes:
        remedy: what was done.
        data: what they were trained on.
        inverters: S of them; none: nothing but corrections.
        seconds: of the training of all S, of what it builds on too.
    """

    remedy: str
    data: str
    inverters: Sequence[Inverter]
    seconds: float


class Trained:
    """How all candidates are trained, and how long the last one took.

    Args:
        seeds: S of them, of data and first weights.
        epochs: of every remedy.
        final_epochs: of the recommended network.
        count: called with S after every epoch.
        checkpoints: folder of checkpoints, one a training, numbered as they come; what is found there is gone on with.

    Attributes:
        seconds: of the last training.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        epochs: int,
        final_epochs: int,
        *,
        count: Counter | None = None,
        checkpoints: Path | None = None,
    ):
        self.seeds, self.epochs, self.final_epochs, self.count = seeds, epochs, final_epochs, count
        self.checkpoints, self.trainings = checkpoints, 0
        self.seconds = 0.0

    def sets(self, scheme: Callable[[int], Scheme]) -> list[DataSet]:
        """One data set a seed."""
        return make_data([scheme(seed) for seed in self.seeds])

    def path(self, noise_deg: float = 0.0) -> list[DataSet]:
        """The training path."""
        return self.sets(lambda seed: TrainingPath(seed=seed, noise=math.radians(noise_deg)))

    def cube(self, farthest: float) -> list[DataSet]:
        """Points in the cube, present joints of points nearby."""
        return self.sets(
            lambda seed: Cube(home=HOME, seed=seed, half_width=FILLED, nearest=0.0, farthest=farthest, redraw=True)
        )

    def train(
        self,
        data: Sequence[DataSet],
        hidden: int,
        *,
        epochs: int | None = None,
        kind: type[Inverter] = Inverter,
        loss: Loss = joint,
        feedback: bool = True,
        start: Sequence[Inverter] = (),
    ) -> list[Inverter]:
        """Train S networks, from their first weights or from where others stand."""
        inverters = remedies.make(kind, self.seeds, hidden, feedback=feedback)
        for inverter, other in zip(inverters, start, strict=False):
            inverter.load_state_dict(other.state_dict())
        file = checkpoint_file(self.checkpoints, "cure", f"{self.trainings:02d}")
        self.trainings += 1
        self.seconds = remedies.train(
            inverters, data, epochs or self.epochs, loss=loss, count=self.count, checkpoint=file
        )
        return inverters


def path_remedies(trained: Trained) -> Iterator[Candidate]:
    """Networks that know one path, the plain ones first."""
    plain = trained.train(trained.path(), SMALL)
    seconds = trained.seconds
    yield Candidate("plain (scheme B)", "training path", plain, seconds)
    for noise in NOISES_DEG:
        noisy = trained.train(trained.path(noise), SMALL)
        yield Candidate(f"noise of +-{noise:g} deg on the present joints", "training path", noisy, trained.seconds)
    data, rolled = trained.path(), plain
    for turn in range(ROUNDS):
        data = remedies.add_rollouts(rolled, data, LONGEST, seed=turn)
        rolled = trained.train(data, SMALL)
        seconds += trained.seconds
    yield Candidate(f"own rollouts, {ROUNDS} rounds", "training path", rolled, seconds)


def cube_remedies(trained: Trained) -> Iterator[Candidate]:
    """Networks that know the cube, the recommended ones last."""
    near, far = trained.cube(NEAR), trained.cube(FAR)
    yield Candidate("traditional", "cube", trained.train(near, MIDDLE, feedback=False), trained.seconds)
    for hidden in (SMALL, MIDDLE):
        yield Candidate("nearby points (scheme D)", _within(FAR), trained.train(far, hidden), trained.seconds)
    middle = trained.train(near, MIDDLE)
    base = trained.seconds
    yield Candidate("nearby points", _within(NEAR), middle, base)
    some = _some(trained.epochs)
    for what, loss in (("contraction penalty", remedies.contraction(PENALTIES[0])), ("FK loss", remedies.pose_loss)):
        further = trained.train(near, MIDDLE, start=middle, loss=loss, epochs=some)
        yield Candidate(f"nearby points, then {what}", _within(NEAR), further, base + trained.seconds)
    yield from _increments(trained, near)
    best = trained.train(near, LARGE, epochs=trained.final_epochs)
    yield Candidate("nearby points, more units", _within(NEAR), best, trained.seconds)


def _increments(trained: Trained, near: Sequence[DataSet]) -> Iterator[Candidate]:
    kind, some = remedies.StepInverter, _some(trained.epochs)
    free = trained.train(near, MIDDLE, kind=kind, loss=remedies.increment_loss)
    yield Candidate("increments", _within(NEAR), free, trained.seconds)
    held = trained.train(near, MIDDLE, kind=kind, loss=remedies.contraction(PENALTIES[1]), epochs=2 * some)
    yield Candidate("increments with contraction penalty", _within(NEAR), held, trained.seconds)


def work(seeds: int, epochs: int, final_epochs: int) -> int:
    """Networks times epochs of all candidates, and of the paper's scheme B with noise, for progress."""
    full = 1 + len(NOISES_DEG) + ROUNDS + 5 + 1 + len(NOISES_DEG)
    return seeds * (full * epochs + 4 * _some(epochs) + final_epochs)


def _within(distance: float) -> str:
    return f"cube, within {1000 * distance:g} mm"


def _some(epochs: int) -> int:
    """Epochs of a loss that costs several times as much an epoch."""
    return max(1, epochs // 5)


__all__ = ["Candidate", "NOISES_DEG", "SMALL", "Trained", "cube_remedies", "path_remedies", "work"]
