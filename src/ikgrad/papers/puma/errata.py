"""The misprints that numbers can show; those of the kinematic equations stand in docs/papers/puma-closed-form.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from ikgrad.papers.printed import read_table
from ikgrad.papers.puma.path import PathRow
from ikgrad.papers.puma.printed_results import PrintedCase
from ikgrad.papers.puma.training import CaseResult
from ikgrad.papers.record import Erratum


def errata(path: Sequence[PathRow], printed: Sequence[PrintedCase], literal: CaseResult) -> tuple[Erratum, ...]:
    """All of them, in the order of the tables, evidence from this run."""
    found = [*_path(path), *_tables(printed), _outputs(printed), *_equations(literal)]
    return tuple(Erratum(number, *entry) for number, entry in enumerate(found, start=1))


Entry = tuple[str, str, str, str]


def _path(path: Sequence[PathRow]) -> Iterator[Entry]:
    for row in path:
        if not row.changes:
            continue
        was = f"off by {max(map(abs, row.residual_mm)):.2f} mm, angle sum {row.angle_sum_deg:.2f}"
        now = f"{max(map(abs, row.corrected_residual_mm)):.3f} mm, {row.corrected_sum_deg:.2f}"
        for change in row.changes.split("; "):
            before, right = change.split("->")
            yield f"Table 1, row {row.row}", before, right, f"{was}; corrected {now}"


def _tables(printed: Sequence[PrintedCase]) -> Iterator[Entry]:
    answers = [float(read_table(f"puma_table{k}")[7]["theta1_NN_deg"]) for k in range(2, 7)]
    yield (
        "Tables 2-4, row 8, theta1D",
        "1.70",
        "-1.70",
        f"Table 1 and Tables 5, 6; every network answers below zero, {min(answers):.2f} to {max(answers):.2f}",
    )
    wrong = float(read_table("puma_table5")[2]["theta2_NN_deg"])
    yield "Table 5, row 3, theta2NN", f"{wrong:.6f}", f"{-wrong:.6f}", "the desired angle is -48.90"
    for case in printed:
        if case.copy_of:
            yield f"table of {case.name}", f"that of {case.copy_of}", "lost", "all 108 entries are the same"
    yield "Table 8", *_table8(printed)


def _table8(printed: Sequence[PrintedCase]) -> tuple[str, str, str]:
    usable = [case for case in printed if not case.copy_of]
    ratios = torch.tensor([case.table8 / case.rms_deg for case in usable])
    by_table8 = " < ".join(case.name for case in sorted(usable, key=lambda case: case.table8))
    by_rms = " < ".join(case.name for case in sorted(usable, key=lambda case: case.rms_deg))
    evidence = (
        f"Table 8 over our rms of Tables 2-6 is {ratios.min():.2f} to {ratios.max():.2f}, no constant; "
        f"order {by_table8} there, {by_rms} in the tables"
    )
    return '"max RMS error"', "undefined", evidence


def _outputs(printed: Sequence[PrintedCase]) -> Entry:
    """Linear outputs would overshoot now and then; logistic ones, scaled to [0, 1], cannot."""
    outside = sum(int(((c.answers_deg < c.low_deg) | (c.answers_deg > c.high_deg)).sum()) for c in printed)
    evidence = f"{outside} of {54 * len(printed)} printed answers leave the range of their column"
    return "eqs. (38), (49)", "linear outputs", "times y (1 - y)", evidence


def _equations(literal: CaseResult) -> Iterator[Entry]:
    lost = literal.diverged_at[literal.diverged_at > 0]
    when = f", not finite from epoch {int(lost.min())}-{int(lost.max())}" if len(lost) else ""
    yield (
        "eq. (58)",
        "-eta S(t) always, no growth limit",
        "both as Fahlman has them",
        f"{len(lost)} of {len(literal.diverged_at)} networks diverge{when}",
    )
    yield (
        "text on eq. (58)",
        "[S(t-1) - S(t)] / dw",
        "[S(t) - S(t-1)] / dw",
        "a second derivative; eq. (58) has it right",
    )
    yield (
        'Table 7, column "mu"',
        "growth limit",
        "momentum",
        "list of symbols; mu = 0 would forbid every step of case 5",
    )


__all__ = ["errata"]
