"""The study as tables for people: plain cells, to be printed by the command line or shown in a notebook."""

from __future__ import annotations

from torch import Tensor

from ikgrad.papers.printed import read_table
from ikgrad.papers.puma.path import path_data
from ikgrad.papers.puma.study import PumaStudy
from ikgrad.papers.record import Cells, Table, checks_table, misprints_table

ANGLES = tuple(f"theta{k}" for k in range(1, 7))


def report(study: PumaStudy) -> list[Table]:
    """All tables, in the order of the paper; parts that were not run are left out."""
    tables = [
        table1(study),
        *tables_2_to_6(study),
        table7(study),
        table8(study),
        ranking(study),
        literal(study),
        *races(study),
        misprints_table(study.errata),
        checks_table(study.checks),
    ]
    return [table for table in tables if table.rows]


def table1(study: PumaStudy) -> Table:
    """The path against forward kinematics."""
    rows = [
        (
            str(row.row),
            *(f"{value:+.2f}" for value in row.residual_mm),
            f"{row.angle_sum_deg:.2f}",
            "right" if row.right else row.changes,
            *(f"{value:+.3f}" for value in row.corrected_residual_mm),
            f"{row.corrected_sum_deg:.2f}",
        )
        for row in study.path
    ]
    columns = ("row", "dx", "dy", "dz", "sum", "verdict", "corrected dx", "dy", "dz", "sum")
    title = "Table 1: FK of the printed joints less the printed position [mm]; theta2 + theta3 + theta5 [deg]"
    return Table(title, columns, tuple(rows))


def tables_2_to_6(study: PumaStudy) -> list[Table]:
    """The answers of each case beside the paper's, ours of the seed with the median rms, printed data."""
    ours = {case.rule.name: case for case in study.cases if case.data == "printed"}
    desired = path_data("printed").q.rad2deg()
    tables = []
    for number, printed in enumerate(study.printed, start=2):
        if printed.name not in ours:
            continue
        case = ours[printed.name]
        answers = desired + case.errors_deg[case.median_seed]
        rows: list[Cells] = []
        for k in range(9):
            rows.append((str(k + 1), "desired", *_cells(desired[k], 2)))
            rows.append(("", "ours", *_cells(answers[k], 3)))
            rows.append(("", "paper", *_cells(printed.answers_deg[k], 3)))
        copied = f" (the paper's is a copy of {printed.copy_of}'s)" if printed.copy_of else ""
        title = f"Table {number}, {printed.name}: joint angles [deg], our median seed{copied}"
        tables.append(Table(title, ("row", "", *ANGLES), tuple(rows), left=2))
    return tables


def table7(study: PumaStudy) -> Table:
    """The training parameters."""
    printed = {row["nn_type"]: row for row in read_table("puma_table7")}
    rows = []
    for rule in study.config.rules:
        paper = printed.get(rule.name)
        sizes = "-".join(map(str, (3, *rule.hidden, 6)))
        used = {
            "backprop": ("momentum",),
            "delta_bar_delta": ("momentum", "kappa", "phi", "theta"),
            "quickprop": ("mu", "max_step"),
        }[rule.rule]
        more = ", ".join(f"{key} {getattr(rule, key):g}" for key in used)
        rows.append(
            (
                rule.name,
                f"{rule.lr:g}",
                paper["eta"] if paper else "-",
                more,
                f"momentum {paper['mu_as_printed']}" if paper else "-",
                str(study.config.epochs),
                paper["N"] if paper else "-",
                f"{sizes} {rule.activation}",
                f"{paper['n_I']}-{paper['n_H']}-{paper['n_O']} {paper['activation']}" if paper else "-",
            )
        )
    columns = ("rule", "eta", "paper", "other settings", "paper", "epochs", "paper", "network", "paper")
    return Table("Table 7: training parameters", columns, tuple(rows), left=9)


def table8(study: PumaStudy) -> Table:
    """Errors of the five cases: the paper's claim, what its own tables give, and ours."""
    ours = {case.rule.name: case for case in study.cases if case.data == "printed"}
    rows = []
    for printed in study.printed:
        tables = "a copy" if printed.copy_of else f"{printed.rms_deg:.4f}"
        largest = "" if printed.copy_of else f"{printed.max_deg:.3f}"
        case = ours.get(printed.name)
        mine = ("-", "-", "-") if case is None else (*_spread(case.rms_deg), _median(case.max_deg))
        rows.append((printed.name, f"{printed.table8:.6f}", tables, largest, *mine))
    columns = (
        "case",
        "Table 8",
        "Tables 2-6: rms [deg]",
        "largest [deg]",
        "ours: median rms [deg]",
        "range",
        "largest, median",
    )
    title = (
        "Table 8: printed (what it measures is not said and cannot be derived), recomputed, and ours on the same data"
    )
    return Table(title, columns, tuple(rows))


def ranking(study: PumaStudy) -> Table:
    """All rules on both data sets, over the seeds."""
    rows = []
    for case in sorted(study.cases, key=lambda case: (case.data != "printed", case.rms_deg.quantile(0.5).item())):
        joint = int(case.joint_rms_deg.quantile(0.5, 0).argmax()) + 1
        rows.append(
            (
                case.data,
                case.rule.name,
                *_spread(case.rms_deg),
                _median(case.joint_rms_deg.amax(-1)),
                f"theta{joint}",
                _median(case.max_deg),
                f"{case.seconds:.1f}",
                str(case.stacked),
            )
        )
    seeds = study.config.seeds
    title = f"Ranking: rms over 9 x 6 angles [deg], {seeds} seeds, {study.config.epochs} epochs"
    columns = (
        "data",
        "rule",
        "median",
        "range",
        "worst joint, median",
        "which",
        "largest, median",
        "time of the stack [s]",
        "networks in it",
    )
    return Table(title, columns, tuple(rows), left=2)


def literal(study: PumaStudy) -> Table:
    """Eq. (58) as printed, at some epochs."""
    case = study.literal
    rows = []
    for epoch, row in zip(case.curve_epochs.tolist(), case.curve, strict=True):
        if epoch in (1, 2, 5, 10, 20, 50, 100, 200, 501, 1000, 2000) or epoch == case.curve_epochs[-1]:
            finite = row[row.isfinite()]
            spread = (
                (f"{finite.median():.3g}", f"{finite.min():.3g} to {finite.max():.3g}") if len(finite) else ("-", "-")
            )
            rows.append((str(epoch), *spread, f"{len(finite)} of {len(row)}"))
    title = "Eq. (58) exactly as printed: root mean square of the scaled outputs' error (0.3 is untrained, 0.5 is lost)"
    return Table(title, ("epoch", "median", "range", "networks that are finite"), tuple(rows))


def races(study: PumaStudy) -> list[Table]:
    """Epochs and seconds to a given error, rules of the paper and of today."""
    tables = []
    for race in study.races:
        rows = [
            (
                row.rule,
                row.stacked,
                f"{row.reached} of {row.seeds}",
                "-" if row.epochs is None else f"{row.epochs:.0f}",
                "-" if row.seconds is None else f"{row.seconds:.2f}",
                f"{row.final_percent:.3g}",
                f"{row.total_epochs}",
                f"{row.total_seconds:.1f}",
            )
            for row in race.rows
        ]
        columns = (
            "rule",
            "networks",
            "reached",
            "epochs, median",
            "seconds, median",
            "error at the end [%]",
            "epochs in all",
            "seconds in all",
        )
        tables.append(Table(f"{race.title}: to {race.target_percent:g} % of a joint's range", columns, tuple(rows), 2))
    return tables


def _cells(values: Tensor, digits: int) -> Cells:
    return tuple(f"{value:.{digits}f}" for value in values.tolist())


def _spread(values: Tensor) -> tuple[str, str]:
    return _median(values), f"{values.min():.4f} to {values.max():.4f}"


def _median(values: Tensor) -> str:
    return f"{values.quantile(0.5):.4f}"


__all__ = ["report"]
