"""The study as tables for people: plain cells, to be printed by the command line or shown in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ikgrad.papers.apps.compare import DescentRow
from ikgrad.papers.apps.study import AppsStudy
from ikgrad.papers.record import Table, checks_table, misprints_table


def report(study: AppsStudy) -> list[Table]:
    """All tables, in the order of the paper; parts that were not run are left out."""
    tables = [
        table3(study),
        table4(study),
        table5(study),
        table6(study),
        newton(study),
        stalls(study),
        learning_rates(study),
        random_starts(study),
        misprints_table(study.errata),
        checks_table(study.checks),
    ]
    return [table for table in tables if table.rows]


def table3(study: AppsStudy) -> Table:
    """Joint values, ours and the paper's, below each other."""
    rows = []
    for row in study.tables.table3:
        digits = 4 if row.quantity == "R_1" else 2
        rows.append((row.motion, row.quantity, "ours", *(f"{value:.{digits}f}" for value in row.ours_deg)))
        mark = ["*" if a != b else "" for a, b in zip(row.printed_deg, row.corrected_deg, strict=True)]
        printed = [f"{value:.{digits}f}{star}" for value, star in zip(row.printed_deg, mark, strict=True)]
        rows.append(("", "", "paper", *printed))
        rows.append(("", "", "difference", *(f"{value:+.5f}" for value in row.difference_deg)))
    title = "Table 3: joint values [deg]; * misprint 4, the difference is to the corrected value"
    return Table(title, ("motion", "", "", *(f"theta_{k}" for k in range(1, 7))), tuple(rows), left=3)


def table4(study: AppsStudy) -> Table:
    """Positions."""
    rows = [
        (
            row.motion,
            row.quantity,
            *(f"{value:.5f}" for value in row.ours_m),
            *(f"{value:.5f}" for value in row.printed_m),
            *(f"{value:+.4f}" for value in row.difference_mm),
        )
        for row in study.tables.table4
    ]
    columns = ("motion", "", "x", "y", "z", "paper x", "paper y", "paper z", "dx [mm]", "dy [mm]", "dz [mm]")
    return Table("Table 4: tool positions [m], differences [mm]", columns, tuple(rows), left=2)


def table5(study: AppsStudy) -> Table:
    """Mean absolute position errors."""
    rows = [
        (
            row.motion,
            *(f"{value:.2f}" for value in row.ours_mm),
            *(f"{value:.2f}" for value in row.printed_mm),
            *(f"{value:.4f}" for value in row.unrounded_mm),
        )
        for row in study.tables.table5
    ]
    names = ("MAE_1", "MAE_2", "MAE_S")
    columns = ("motion", *names, *(f"paper {name}" for name in names), *(f"unrounded {name}" for name in names))
    return Table("Table 5: mean absolute position errors [mm]", columns, tuple(rows))


def table6(study: AppsStudy) -> Table:
    """APPS and Newton-Raphson."""
    rows = []
    for apps, nr in zip(study.tables.table6, study.newton, strict=True):
        paper = f"{_mm(nr.printed_mae_mm)}" if nr.printed_mae_mm is not None else "FALSE"
        rows.append(
            (
                apps.motion,
                _count(apps.iterations),
                str(apps.printed_iterations),
                _mm(apps.mae_mm),
                _mm(apps.printed_mae_mm),
                f"{apps.seconds:.2f}",
                f"{apps.printed_seconds:.2f}",
                _count(nr.iterations),
                "-" if nr.printed_iterations is None else str(nr.printed_iterations),
                f"{nr.mae_mm:.0e}",
                paper,
            )
        )
    apps_columns = ("motion", "iterations", "paper", "MAE [mm]", "paper", "time [s]", "paper")
    columns = (*apps_columns, "NR iterations", "paper", "NR MAE [mm]", "paper")
    return Table("Table 6: APPS and Newton-Raphson (NR)", columns, tuple(rows))


def newton(study: AppsStudy) -> Table:
    """Newton-Raphson as it should be, and the variant that may explain the paper's rows."""
    pairs = zip(study.newton, study.newton_tool_frame, strict=True)
    rows = [
        (good.motion, _count(good.iterations), f"{good.mae_mm:.1e}", _count(bad.iterations), f"{bad.mae_mm:.3g}")
        for good, bad in pairs
    ]
    columns = ("motion", "iterations", "MAE [mm]", "tool-frame error: iterations", "best MAE [mm]")
    return Table("Newton-Raphson from the same starts, and with an inconsistent rotation error", columns, tuple(rows))


def stalls(study: AppsStudy) -> Table:
    """What is left of E with the printed settings, and with eq. (20) as printed."""
    rows = [("printed settings, eta 0.01", *_finals(study.printed_settings))]
    for rate in study.config.learning_rates:
        group = [row for row in study.literal_rule if row.eta == rate]
        rows.append((f"eq. (20) as printed, eta {rate:g}", *_finals(group)))
    title = f"E after {study.printed_settings[0].max_steps} iterations, none converged unless a count is given"
    return Table(title, ("", *(motion.name for motion in study.motions)), tuple(rows))


def learning_rates(study: AppsStudy) -> Table:
    """Iterations by learning rate."""
    rows = []
    for rate in study.config.learning_rates:
        group = [row for row in study.learning_rates if row.eta == rate]
        cells = [str(row.iterations) if row.iterations else f"never, E {row.E_final:.0e}" for row in group]
        rows.append((f"{rate:g}", *cells))
    rows.append(("stable below", *(f"{rate:.4f}" for rate in study.stable_rates)))
    limit = study.config.learning_rate_max_steps
    title = f"Iterations by learning rate (E plain sum, E0 1e-9, at most {limit})"
    return Table(title, ("eta", *(motion.name for motion in study.motions)), tuple(rows))


def random_starts(study: AppsStudy) -> Table:
    """All methods on random starts and poses."""
    rows = [
        (
            row.method,
            f"{100 * row.reached:.1f} %",
            f"{100 * row.inside_limits:.1f} %",
            "-" if row.iterations_median is None else f"{row.iterations_median:.0f}",
            "-" if row.iterations_p95 is None else f"{row.iterations_p95:.0f}",
            str(row.max_steps),
            f"{row.ms_per_pose:.2f}",
        )
        for row in study.random_starts
    ]
    config = study.config
    title = (
        f"{config.random_starts} random starts and reachable poses, seed {config.seed}; "
        f"reached: within {config.tol_pos * 1e3:g} mm and {config.tol_rot * 1e3:g} mrad by forward kinematics"
    )
    columns = ("method", "reached", "inside limits", "iterations, median", "95 %", "at most", "time a pose [ms]")
    return Table(title, columns, tuple(rows))


def _finals(rows: Iterable[DescentRow]) -> Sequence[str]:
    return [str(row.iterations) if row.iterations else f"{row.E_final:.0e}" for row in rows]


def _count(iterations: int | None) -> str:
    return "never" if iterations is None else str(iterations)


def _mm(value: float) -> str:
    return f"{value:.2f}"
