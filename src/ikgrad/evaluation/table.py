"""An evaluation as cells of a table: the same ones on the terminal, in Markdown and in the report.

What makes a table too wide for a terminal, and digits that nobody needs, are in the record alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ikgrad.evaluation.records import Evaluation, Row

_Column = tuple[str, Callable[[Row], str]]


def cells(evaluation: Evaluation) -> list[list[str]]:
    """The head and one row a method; a column is left out where its protocol does not measure it."""
    columns = [column for column in _COLUMNS if any(column[1](row) for row in evaluation.rows)]
    return [[name for name, _ in columns], *([show(row) for _, show in columns] for row in evaluation.rows)]


def number(value: float) -> str:
    """Two digits, or three and more before the point; what is below a millionth is nothing to anybody.

    Example:
        >>> [number(x) for x in (0.0, 3e-13, 0.00123, 2.345, 17.2, 1234.5, float("inf"))]
        ['<1e-6', '<1e-6', '0.0012', '2.3', '17', '1,234', 'inf']
    """
    if value < 1e-6:
        return "<1e-6"
    return f"{value:,.0f}" if 99.5 <= value < float("inf") else f"{value:.2g}".replace("e-0", "e-")


def percent(share: float) -> str:
    """A share as it is read.

    Example:
        >>> percent(0.98765), percent(1.0)
        ('98.77 %', '100.00 %')
    """
    return f"{100 * share:.2f} %"


def _triple(values: Sequence[float]) -> str:
    return " / ".join(map(number, values))


def _extra(key: str, show: Callable[[float], str]) -> Callable[[Row], str]:
    return lambda row: show(row.extra[key]) if key in row.extra else ""


def _unless_solved(show: Callable[[Row], str]) -> Callable[[Row], str]:
    """Of answers that a solver judged by its tolerance, percentiles say nothing but the tolerance."""
    return lambda row: "" if "solved" in row.extra else show(row)


def _steps(row: Row) -> str:
    return f"{row.extra['steps']:.1f} / {row.extra['steps_99']:.0f}" if "steps" in row.extra else ""


_COLUMNS: list[_Column] = [
    ("method", lambda row: row.method),
    ("solved", _extra("solved", percent)),
    ("steps, mean / 99 %", _steps),
    ("position [mm]", _unless_solved(lambda row: _triple(row.errors.position_mm))),
    ("rotation [deg]", _unless_solved(lambda row: _triple(row.errors.rotation_deg))),
    ("mean [mm]", _extra("mean_position_mm", number)),
    ("mean [deg]", _extra("mean_rotation_deg", number)),
    ("inside", _unless_solved(lambda row: percent(row.errors.inside))),
    ("1 mm, 0.01 rad", _unless_solved(lambda row: percent(row.errors.close))),
    ("1e-6 m, 1e-6 rad", _unless_solved(lambda row: "" if "largest_jump" in row.extra else percent(row.errors.exact))),
    ("reconfigurations", _extra("reconfigurations", lambda x: f"{x:,.0f}")),
    ("largest jump [rad]", _extra("largest_jump", number)),
    ("us a pose", lambda row: f"{row.microseconds:.2f}"),
    ("of the engine's time", _extra("time_ratio", lambda x: f"{x:.2f}")),
]

__all__ = ["cells", "number", "percent"]
