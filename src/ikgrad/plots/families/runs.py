"""Training runs: learning curves, with their range over the members of a run and over runs that differ by the seed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ikgrad.errors import DataError
from ikgrad.files.peek import Peek
from ikgrad.plots.families import evaluations
from ikgrad.plots.families.base import Draw, Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ikgrad.plots.curves import Curve, Group

_SAME = ("seed", "members", "tensorboard", "threads")  # settings by which runs of one group may differ


class Run(NamedTuple):
    """What a run folder says.

    Attributes:
        name: of the folder.
        settings: of config.yaml.
        columns: of history.csv.
        rows: (k, columns), NaN where a cell is empty.
    """

    name: str
    settings: Mapping[str, Any]
    columns: tuple[str, ...]
    rows: np.ndarray


def find(looks: Sequence[Peek]) -> Found | None:
    """Folders with ``run.json``."""
    from ikgrad.training.run_folder import EVALUATION, REPORT

    for look in looks:
        if not (look.kind == "folder" and (look.path / REPORT).is_file()):
            if look is looks[0]:
                return None
            raise DataError(f"{look.path}: is no training run; several inputs must all be training runs")
    found: dict[str, Draw] = {"learning": lambda options: _learning(looks)}
    path = looks[0].path / EVALUATION
    if len(looks) == 1 and path.is_file():
        records = json.loads(path.read_text(encoding="utf-8"))
        if evaluations.is_evaluation(records):
            found |= evaluations.figures(records, title=looks[0].path.name)
    return found


def read_run(look: Peek) -> Run:
    """Settings and history of a run.

    Raises:
        DataError: there is no history yet, or a file is damaged.
    """
    from yaml import YAMLError, safe_load  # type: ignore[import-untyped]

    from ikgrad.training.run_folder import CONFIG, HISTORY

    try:
        settings = safe_load((look.path / CONFIG).read_text(encoding="utf-8"))
        head, *lines = (look.path / HISTORY).read_text(encoding="utf-8").split()
        rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines])
    except (OSError, ValueError, YAMLError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DataError(f"{look.path}: has no curve that can be read: {reason}") from error
    if not len(rows):
        raise DataError(f"{look.path}: its history has no rows yet")
    return Run(look.path.resolve().name, settings, tuple(head.split(",")), rows)


def _learning(looks: Sequence[Peek]) -> Figure:
    from ikgrad.plots.curves import Group, curve_panels

    runs = [read_run(look) for look in looks]
    if len({run.columns for run in runs}) > 1:
        raise DataError("runs of the model classic and of the others have different curves; draw them one by one")
    columns = runs[0].columns
    panels, xlabel = _CLASSIC if columns[0] == "epoch" else _STREAM
    groups = []
    for name, members in _grouped(runs).items():
        lines = {label: [_curve(run, k, column) for run in members for k in _members(run)] for label, column in panels}
        groups.append(Group(name, {label: curves for label, curves in lines.items() if any(len(c.x) for c in curves)}))
    title = f"{', '.join(dict.fromkeys(_robot(run) for run in runs))}: {_counted(groups)}"
    return curve_panels(groups, _LABELS[columns[0]], xlabel=xlabel, title=title)


_CLASSIC = ((("training", "train"), ("validation", "validation")), "epoch")
_STREAM = (
    (
        ("position, median", "position_median_mm"),
        ("position, 95 %", "position_95_mm"),
        ("rotation, median", "rotation_median_deg"),
        ("rotation, 95 %", "rotation_95_deg"),
    ),
    "step",
)
_LABELS = {
    "epoch": {"mean squared error [units of the loss]": ("training", "validation")},
    "step": {
        "position error [mm]": ("position, median", "position, 95 %"),
        "rotation error [deg]": ("rotation, median", "rotation, 95 %"),
    },
}


def _grouped(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Runs that differ by nothing but the seed belong together; a group is named by what tells it from the others."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        kept = {key: value for key, value in run.settings.items() if key not in _SAME}
        groups.setdefault(json.dumps(kept, sort_keys=True, default=str), []).append(run)
    settings = [members[0].settings for members in groups.values()]
    keys = {key for found in settings for key in found if key not in _SAME}
    differing = sorted(key for key in keys if len({str(found.get(key)) for found in settings}) > 1)
    names = [", ".join(f"{key} {found.get(key)}" for key in differing[:2]) for found in settings]
    if len(set(names)) < len(names):
        names = [members[0].name for members in groups.values()]
    return dict(zip(names, groups.values(), strict=True))


def _members(run: Run) -> list[int]:
    return sorted({int(member) for member in run.rows[:, run.columns.index("member")]})


def _curve(run: Run, member: int, column: str) -> Curve:
    from ikgrad.plots.curves import Curve

    mine = run.rows[run.rows[:, run.columns.index("member")] == member]
    y = mine[:, run.columns.index(column)]
    kept = np.isfinite(y)
    return Curve(mine[kept, 0], y[kept])


def _robot(run: Run) -> str:
    return str(run.settings.get("robot", run.name)).rpartition("/")[2].removesuffix(".urdf")


def _counted(groups: Sequence[Group]) -> str:
    most = max(len(curves) for group in groups for curves in group.lines.values())
    return "one training" if most == 1 else f"median and range over {most} trainings"


FAMILY = Family("a training run", find, several=True)
