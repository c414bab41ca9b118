"""What is claimed about the reproduction, each claim judged on the numbers of this very run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from ikgrad.papers.printed import read_table
from ikgrad.papers.puma.path import POSITION_TOLERANCE_MM, PathRow
from ikgrad.papers.puma.printed_results import PrintedCase
from ikgrad.papers.puma.training import CaseResult
from ikgrad.papers.record import Check

PLAIN, ADAPTIVE = ("OBP", "OBPR", "BBP"), ("DBD", "QP")
SHORT, LONG = 111_111, 1_000_000  # epochs that the claims speak of: 1e6 patterns shown, and the paper's N
LEAD = 10.0


def check(
    path: Sequence[PathRow], printed: Sequence[PrintedCase], cases: Sequence[CaseResult], literal: CaseResult
) -> tuple[Check, ...]:
    """The claims that this run can judge: those on errors need 111,111 or 1,000,000 epochs."""
    ours = {case.rule.name: case for case in cases if case.data == "printed"}
    return (*_tables(path, printed), *_errors(ours), *_ranking(ours), _literal(literal))


def _tables(path: Sequence[PathRow], printed: Sequence[PrintedCase]) -> Iterator[Check]:
    worst = max(abs(value) for row in path for value in row.corrected_residual_mm)
    claim = f"FK of the corrected Table 1 within {POSITION_TOLERANCE_MM} mm"
    yield Check(claim, worst <= POSITION_TOLERANCE_MM, f"{worst:.3f} mm")
    wrong = [row.row for row in path if not row.right]
    yield Check("the rows of Table 1 that FK refuses are those corrected", wrong == [2, 3, 6, 9], f"rows {wrong}")
    stored = {row["algorithm"]: float(row["rms_all_deg"]) for row in read_table("puma_recomputed_errors")}
    off = max(abs(stored[case.name] - case.rms_deg) for case in printed)
    yield Check("errors of Tables 2-6 to six decimals", off < 1e-6, f"within {off:.1e} deg of the stored values")


def _errors(ours: dict[str, CaseResult]) -> Iterator[Check]:
    for name, case in ours.items():
        low, high = case.rms_deg.min().item(), case.rms_deg.max().item()
        middle = case.rms_deg.quantile(0.5).item()
        if name in PLAIN and case.epochs in (SHORT, LONG):
            least, most = (0.6, 1.3) if case.epochs == SHORT else (0.25, 0.42)
            claim = f"{name}: median rms between {least} and {most} deg after {case.epochs} epochs"
            inside = int(((case.rms_deg >= least) & (case.rms_deg <= most)).sum())
            measured = f"{middle:.3f}; {inside} of {len(case.rms_deg)} seeds inside, all {low:.3f} to {high:.3f}"
            yield Check(claim, least <= middle <= most, measured)
        elif name in ADAPTIVE and case.epochs >= SHORT:
            claim = f"{name}: median rms below 0.08 deg after {case.epochs} epochs"
            yield Check(claim, middle < 0.08, f"{middle:.4f} ({low:.4f} to {high:.4f}), {len(case.rms_deg)} seeds")


def _ranking(ours: dict[str, CaseResult]) -> Iterator[Check]:
    if not set(PLAIN + ADAPTIVE) <= set(ours) or ours["OBP"].epochs < SHORT:
        return
    best = min(ours[name].rms_deg.quantile(0.5).item() for name in PLAIN)
    worst = max(ours[name].rms_deg.quantile(0.5).item() for name in ADAPTIVE)
    claim = f"DBD and QP ahead of OBP, OBPR and BBP by {LEAD:g} times, medians"
    yield Check(claim, best >= LEAD * worst, f"{best / worst:.1f} times")


def _literal(literal: CaseResult) -> Check:
    """Diverged: not finite, or worse than an untrained network, whose rms is that of answering the middle."""
    lost = (literal.diverged_at > 0) | ~(literal.rms_deg < 20.0)
    total = len(literal.rms_deg)
    last = torch.where(literal.curve.isfinite(), literal.curve, torch.inf).amin(-1)[-1]
    return Check(
        f"eq. (58) as printed diverges within {literal.curve_epochs[-1]} epochs",
        bool(lost.all()),
        f"{int(lost.sum())} of {total} seeds; smallest scaled rms at the end {last:.2g}",
    )


__all__ = ["check"]
