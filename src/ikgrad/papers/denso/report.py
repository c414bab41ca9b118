"""The study as tables for people: plain cells, to be printed by the command line or shown in a notebook."""

from __future__ import annotations

from torch import Tensor

from ikgrad.papers.denso.cure_report import cure_tables
from ikgrad.papers.denso.networks import median
from ikgrad.papers.denso.schemes import LOST_MM, NOISES_DEG, RADIUS, RISE, percentages
from ikgrad.papers.denso.study import DensoStudy
from ikgrad.papers.printed import find_row, read_table
from ikgrad.papers.record import Cells, Table, checks_table, misprints_table

PAPER = {"traditional": "traditional", "feedback": "proposed"}
NETWORKS = ("feedback", "traditional")  # as in Table 2


def report(study: DensoStudy) -> list[Table]:
    """All tables, in the order of the paper."""
    return [
        matrices(study),
        scheme_b(study),
        closed_loop(study),
        scheme_a(study),
        schemes_c_and_d(study),
        helix(study),
        table2(study),
        table3(study),
        *cure_tables(study.loop),
        misprints_table(study.errata),
        checks_table(study.checks),
    ]


def matrices(study: DensoStudy) -> Table:
    """The printed matrices against ours."""
    rows = [(row.name, row.at, row.note, f"{row.difference:.1e}") for row in study.matrices]
    return Table("Printed matrices against Table 1", ("matrix", "at", "", "largest difference"), tuple(rows), left=3)


def scheme_b(study: DensoStudy) -> Table:
    """Scheme B, the paper's numbers and ours."""
    rows: list[Cells] = []
    for result in (study.path.traditional, study.path.feedback):
        printed = find_row("denso_networks", network=PAPER[result.name])
        paper_mm = max(float(row[f"{PAPER[result.name]}_max_error_mm"]) for row in read_table("denso_path_errors"))
        rows.append((result.name, "paper", printed["stop_epoch"], printed["best_mse"], "", printed["regression_R"], ""))
        rows[-1] = (*rows[-1], f"{paper_mm:g} (on the helix)", "")
        worst = result.position_mm.amax(-1)
        rows.append(
            (
                "",
                "ours",
                str(result.epochs),
                f"{median(result.mse):.3g}",
                _range(result.mse, ".2g"),
                f"{median(result.regression):.6f}",
                _range(result.regression, ".6f"),
                f"{median(worst):.2f} ({_range(worst, '.2f')})",
                f"{result.seconds:.0f}",
            )
        )
    columns = ("network", "", "epochs", "MSE [rad^2]", "range", "R", "range", "worst axis [mm]", "time of all [s]")
    seeds = len(study.path.feedback.mse)
    title = f"Scheme B: one smooth path, present joints of the sample before; {seeds} seeds, median and range"
    note = f"; copying the present joints: {study.path.copy_mse:.2g}"
    return Table(title + note, columns, tuple(rows), left=2)


def closed_loop(study: DensoStudy) -> Table:
    """What the paper does not show: the feedback network fed with its own answers."""
    path = study.path
    rows = [
        (str(seed), f"{path.feedback.mse[seed]:.2g}", f"{path.drift_mm[seed]:.0f}", _step(path.lost_at[seed]))
        for seed in range(len(path.drift_mm))
    ]
    title = f"Scheme B in closed loop, on its own training path of {len(path.drift)} steps"
    return Table(title, ("seed", "one-step MSE [rad^2]", "worst error [mm]", f"first over {LOST_MM:g} mm"), tuple(rows))


def scheme_a(study: DensoStudy) -> Table:
    """Scheme A, with the baseline of copying in the last row."""
    rows = [
        (f"+-{row.box_deg:g} deg", f"{row.traditional:.2g}", *(_gain(value, row.traditional) for value in row.feedback))
        for row in study.boxes
    ]
    rows.append(("copy the present joints", "", *(f"{value:.2g}" for value in study.boxes[0].copy)))
    columns = ("box about home", "traditional", *(f"feedback, +-{noise:g} deg" for noise in NOISES_DEG))
    title = f"Scheme A: joints uniform in a box; MSE [rad^2] (gain), {study.config.epochs} epochs, one seed a cell"
    return Table(title, columns, tuple(rows))


def schemes_c_and_d(study: DensoStudy) -> Table:
    """Schemes C and D."""
    rows = [
        (row.title, f"{row.traditional:.2g}", _gain(row.feedback, row.traditional), f"{row.copy:.2g}")
        for row in study.pairs
    ]
    title = f"Schemes C and D: MSE [rad^2] (gain), gripper down, {study.config.epochs} epochs, one seed"
    return Table(title, ("scheme", "traditional", "feedback", "copy"), tuple(rows))


def helix(study: DensoStudy) -> Table:
    """The helix of the experiment in millimetres."""
    track = study.track
    rows: list[Cells] = []
    for name in PAPER:
        printed = [row[f"{PAPER[name]}_max_error_mm"] for row in read_table("denso_path_errors")]
        rows.append((name, "paper", *printed))
        for what, errors in (("one-step", track.one_step_mm[name]), ("closed loop", track.closed_mm[name])):
            rows.append(
                ("", f"ours, {what}", *(f"{median(errors[:, k]):.3f} ({_range(errors[:, k])})" for k in range(3)))
            )
    title = (
        f"Helix of radius {RADIUS} m and rise {RISE} m, networks trained by scheme D in +-5 cm, "
        f"{track.feedback.epochs} epochs: largest error [mm], median and range of {len(track.feedback.mse)} seeds"
    )
    return Table(title, ("network", "", "x", "y", "z"), tuple(rows), left=2)


def table2(study: DensoStudy) -> Table:
    """Table 2: millimetres first, then percentages by two definitions, then the errors of the joints."""
    errors = {name: median(study.track.closed_mm[name]) for name in NETWORKS}
    shares = {name: percentages(errors[name], study.track.path) for name in NETWORKS}
    printed_mm = {row["axis"]: row for row in read_table("denso_path_errors")}
    rows: list[Cells] = []
    for k, axis in enumerate("xyz"):
        cells = [(printed_mm[axis][f"{PAPER[n]}_max_error_mm"], f"{errors[n][k]:.2f}") for n in NETWORKS]
        rows.append((f"{axis}, largest error [mm], scheme D", *cells[0], *cells[1]))
    for kind, length in (("amplitude", "half its range"), ("coordinate", "its largest value")):
        for k, axis in enumerate("xyz"):
            printed = find_row("denso_table2", parameter=f"P{axis}_error_percent")
            cells = [(printed[PAPER[n]], f"{shares[n][kind][k]:.2f}") for n in NETWORKS]
            rows.append((f"{axis}, in % of {length}", *cells[0], *cells[1]))
    results = {"feedback": study.path.feedback, "traditional": study.path.traditional}
    for label, parameter in (("MSE [rad^2], scheme B", "MSE"), ("R, scheme B", "regression")):
        printed = find_row("denso_table2", parameter=parameter)
        ours = {
            n: f"{median(r.mse):.3g}" if parameter == "MSE" else f"{median(r.regression):.6f}"
            for n, r in results.items()
        }
        cells = [(printed[PAPER[n]], ours[n]) for n in NETWORKS]
        rows.append((label, *cells[0], *cells[1]))
    seeds = len(study.track.feedback.mse)
    return Table(
        f"Table 2: the helix in closed loop and the test rows, medians of {seeds} seeds; "
        "the paper does not say what its percentages refer to",
        ("", "proposed: paper", "feedback: ours", "traditional: paper", "ours"),
        tuple(rows),
    )


def table3(study: DensoStudy) -> Table:
    """Table 3: the paper's comparison with others, quoted, and ours."""
    mm = median(study.track.closed_mm["feedback"])
    errors = " ".join(f"{axis}={value:.2f}" for axis, value in zip("xyz", mm.tolist(), strict=True)) + " mm"
    share = percentages(mm, study.track.path)["amplitude"].tolist()
    errors += "; " + " ".join(f"{axis}={value:.2f}%" for axis, value in zip("xyz", share, strict=True))
    mse = f"{median(study.path.feedback.mse):.2g}"
    ours = ("this run", "Denso", "6", "ANN", mse, "10", f"{errors} of half the range")
    rows = [tuple(row.values()) for row in read_table("denso_table3")]
    columns = ("study", "system", "joints", "method", "MSE", "hidden (neurons)", "errors")
    return Table("Table 3: other studies as the paper quotes them", columns, (rows[0], ours, *rows[1:]), left=7)


def _gain(value: float, reference: float) -> str:
    return f"{value:.2g} ({reference / value:.2g}x)"


def _range(values: Tensor, form: str = ".2f") -> str:
    return f"{values.min():{form}} to {values.max():{form}}"


def _step(step: Tensor) -> str:
    return "never" if step < 0 else f"step {int(step)}"


__all__ = ["report"]
