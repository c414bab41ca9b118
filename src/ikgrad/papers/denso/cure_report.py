"""The closed loop as tables for people, and what is claimed about it."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from ikgrad.papers.denso.cure import SPEEDS, CureStudy, LoopRow
from ikgrad.papers.denso.networks import median
from ikgrad.papers.denso.paths import HALF_WIDTH, LAP, PATHS
from ikgrad.papers.record import Cells, Check, Table

WANTED_MM, LOST_MM, CORRECTED_M = 0.5, 10.0, 1e-6
FULL_EPOCHS, FULL_TICKS = 80, 20_000  # from which the claims on the cure are made


def cure_tables(study: CureStudy) -> list[Table]:
    """All tables of the closed loop."""
    return [remedies(study), by_path(study), speeds(study), noise(study)]


def remedies(study: CureStudy) -> Table:
    """Every remedy in one row."""
    seeds = len(study.rows[0].worst_mm)
    unit = study.rows[0].seconds[1]
    rows = [_remedy(row, unit, mark="*" if k == study.best else "") for k, row in enumerate(study.rows)]
    title = (
        f"The closed loop cured: {seeds} seeds, five kinds of path in the cube of +-{100 * HALF_WIDTH:g} cm, "
        f"{study.ticks} ticks each, {LAP} a lap; median and range over seeds of the worst error over all paths. "
        f"{study.epochs} epochs, {study.final_epochs} for the network marked *. Cost 1: {1e6 * unit:.0f} us"
    )
    columns = (
        *("remedy", "trained on", "units", "one-step MSE [rad^2]", "spectral radius, worst", "worst error [mm]"),
        *(f"within {WANTED_MM:g} mm", "drift [mm]", "cost a tick", "training [s]"),
    )
    return Table(title, columns, tuple(rows), left=2)


def _remedy(row: LoopRow, unit: float, *, mark: str) -> Cells:
    worst, network = row.worst_mm.amax(-1), row.hidden > 0
    return (
        row.remedy + mark,
        row.data,
        str(row.hidden) if network else "",
        f"{median(row.mse):.1e}" if network else "",
        f"{row.gain.max():.2f}" if network else "",
        _spread(worst),
        f"{int((worst < WANTED_MM).sum())} of {len(worst)}",
        f"{row.drift_mm.max():.1g}",
        f"{row.seconds[1] / unit:.2g}",
        f"{row.seconds[0]:.0f}",
    )


def by_path(study: CureStudy) -> Table:
    """The recommended network, alone and corrected, path by path."""
    rows = [
        (path, *(_spread(study.rows[k].worst_mm[:, p]) for k in (study.best, study.corrected)))
        for p, path in enumerate(PATHS)
    ]
    title = "The network marked *, path by path: worst error [mm], median and range over seeds"
    return Table(title, ("path", "alone", "with one correction a tick"), tuple(rows))


def speeds(study: CureStudy) -> Table:
    """What a network is worth beside a damped step, on paths of few points."""
    rows = [(row.what, *map(_spread, row.worst_mm)) for row in study.speeds]
    title = "Fewer points, larger steps: worst error [mm] over all paths, two laps"
    return Table(title, ("", *(f"{lap} ticks a lap" for lap in SPEEDS)), tuple(rows))


def noise(study: CureStudy) -> Table:
    """Scheme B of the paper's study with noise."""
    rows = [(f"+-{row.noise_deg:g} deg", _spread(row.mse), _spread(row.worst_mm)) for row in study.noise]
    title = f"Scheme B, one smooth path of all joints, noise on the present joints, {study.epochs} epochs"
    return Table(title, ("noise", "one-step MSE [rad^2]", "closed loop on its own path [mm]"), tuple(rows))


def check_cure(study: CureStudy) -> Iterator[Check]:
    """The claims that this run can judge."""
    if study.final_epochs < FULL_EPOCHS or study.ticks < FULL_TICKS:
        return
    seeds = len(study.rows[0].worst_mm)
    plain = study.rows[0].worst_mm.amax(-1)
    yield Check(
        f"Loop: no network trained on one path alone stays within {WANTED_MM:g} mm (a negative result)",
        bool((plain > WANTED_MM).all()),
        f"{int((plain > LOST_MM).sum())} of {seeds} seeds are over {LOST_MM:g} mm off, worst {_spread(plain)} mm",
    )
    alone = study.rows[study.best].worst_mm
    yield Check(
        f"Loop: the cured network alone within {WANTED_MM:g} mm on all five paths, {study.ticks} ticks, every seed",
        bool((alone < WANTED_MM).all()),
        f"{int((alone < WANTED_MM).all(-1).sum())} of {seeds} seeds, worst errors {_spread(alone.amax(-1))} mm",
    )
    corrected = study.rows[study.corrected].worst_mm.amax(-1) / 1000
    yield Check(
        f"Loop: with one correction a tick within {CORRECTED_M:g} m, {LAP} ticks a lap, every seed",
        bool((corrected < CORRECTED_M).all()),
        f"{int((corrected < CORRECTED_M).sum())} of {seeds} seeds, worst errors {_spread(corrected)} m",
    )


def _spread(values: Tensor) -> str:
    return f"{median(values):.3g} ({values.min():.3g} to {values.max():.3g})"


__all__ = ["check_cure", "cure_tables"]
