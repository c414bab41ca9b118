"""The whole study as one record: `run_study` computes it, `DensoStudy.to_json` hands it to a program."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from ikgrad import __version__
from ikgrad.config import DensoConfig
from ikgrad.papers.denso import candidates, schemes
from ikgrad.papers.denso.arm import MatrixRow, check_matrices
from ikgrad.papers.denso.checks import check
from ikgrad.papers.denso.cure import CureStudy, cure
from ikgrad.papers.denso.cure_report import check_cure
from ikgrad.papers.denso.errata import errata
from ikgrad.papers.denso.schemes import BoxRow, PairRow, PathStudy, TrackStudy
from ikgrad.papers.record import Check, Erratum, one_thread, plain

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class DensoStudy:
    """Everything that ``ikgrad reproduce denso`` shows.

    Attributes:
        config: the settings.
        versions: of the packages that the numbers depend on.
        seconds: of the whole run.
        matrices: the printed matrices against ours.
        path: scheme B, the one that gives the paper's numbers, and its closed loop.
        boxes: scheme A, where the claim does not hold.
        pairs: schemes C and D.
        track: the helix of the experiment, followed by networks of scheme D.
        loop: the closed loop cured.
        errata: the misprints.
        checks: what is claimed, and whether it holds here.
    """

    config: DensoConfig
    versions: dict[str, str]
    seconds: float
    matrices: tuple[MatrixRow, ...]
    path: PathStudy
    boxes: tuple[BoxRow, ...]
    pairs: tuple[PairRow, ...]
    track: TrackStudy
    loop: CureStudy
    errata: tuple[Erratum, ...]
    checks: tuple[Check, ...]

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain dictionaries and lists; curves are left out."""
        return {
            "paper": "denso",
            "config": asdict(self.config),
            "versions": self.versions,
            "seconds": self.seconds,
            "matrices": [asdict(row) for row in self.matrices],
            "scheme_b": _numbers(self.path),
            "scheme_a": [plain(asdict(row)) for row in self.boxes],
            "schemes_c_and_d": [asdict(row) for row in self.pairs],
            "helix": _numbers(self.track),
            "closed_loop": _numbers(self.loop),
            "errata": [asdict(erratum) for erratum in self.errata],
            "checks": [asdict(check) for check in self.checks],
        }


def run_study(
    config: DensoConfig | None = None, *, checkpoints: Path | None = None, progress: Progress | None = None
) -> DensoStudy:
    """Train all networks and compare them with the paper.

    Args:
        config: settings; default: `DensoConfig`.
        checkpoints: folder of checkpoints; what is found there is gone on with.
        progress: called as ``progress(label, done, total)`` after every epoch, in networks times epochs.

    Raises:
        DataError: a checkpoint is of other settings, or damaged.

    Example:
        >>> few = dict(traditional_epochs=3, feedback_epochs=3, epochs=3, cure_epochs=2, final_epochs=2, ticks=50)
        >>> study = run_study(DensoConfig(seeds=2, **few))
        >>> study.matrices[0].difference
        0.0
    """
    config = config or DensoConfig()
    path_epochs = (config.traditional_epochs, config.feedback_epochs)
    counter = _Counter(progress, total=_work(config))
    start = time.perf_counter()
    with one_thread():
        path = schemes.scheme_b(config.seeds, path_epochs, count=counter.of("scheme B"), checkpoints=checkpoints)
        boxes = schemes.scheme_a(config.epochs, count=counter.of("scheme A"), checkpoints=checkpoints)
        pairs = schemes.schemes_c_and_d(config.epochs, count=counter.of("schemes C and D"), checkpoints=checkpoints)
        track = schemes.track(config.seeds, config.epochs, count=counter.of("helix"), checkpoints=checkpoints)
        loop = cure(
            range(config.cure_seed, config.cure_seed + config.seeds),
            config.cure_epochs,
            config.final_epochs,
            config.ticks,
            count=counter.of("closed loop"),
            checkpoints=checkpoints,
        )
    matrices = check_matrices()
    return DensoStudy(
        config,
        {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
        time.perf_counter() - start,
        matrices,
        path,
        boxes,
        pairs,
        track,
        loop,
        errata=errata(matrices),
        checks=(*check(matrices, path, boxes, track), *check_cure(loop)),
    )


def _work(config: DensoConfig) -> int:
    """Networks times epochs of all parts."""
    path_epochs = (config.traditional_epochs, config.feedback_epochs)
    cured = candidates.work(config.seeds, config.cure_epochs, config.final_epochs)
    return schemes.work(config.seeds, config.epochs, path_epochs) + cured


class _Counter:
    """Adds up the epochs of one part after another."""

    def __init__(self, progress: Progress | None, *, total: int):
        self.progress, self.total, self.done = progress, total, 0

    def of(self, part: str) -> Callable[[int], None]:
        """What a part calls with the epochs that it has done."""

        def count(networks: int) -> None:
            self.done += networks
            if self.progress is not None:
                self.progress(f"denso: {part}", self.done, self.total)

        return count


def _numbers(record: Any) -> Any:
    """A record of numbers, tensors and records as plain values; what is as long as a path or a training is left out."""
    if isinstance(record, torch.Tensor):
        return record.tolist()
    if isinstance(record, dict):
        return {key: _numbers(value) for key, value in record.items()}
    if isinstance(record, tuple):
        return [_numbers(value) for value in record]
    if not hasattr(record, "__dataclass_fields__"):
        return record
    long = ("curve_train", "curve_validation", "drift", "path", "errors_mm", "targets", "answers")
    return {key: _numbers(value) for key, value in vars(record).items() if key not in long}


__all__ = ["DensoStudy", "run_study"]
