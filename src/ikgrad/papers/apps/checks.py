"""What is claimed about the reproduction, each claim judged on the numbers of this very run."""

from __future__ import annotations

from collections.abc import Sequence

from ikgrad.papers.apps.compare import DescentRow, NewtonRow
from ikgrad.papers.apps.tables import Tables
from ikgrad.papers.record import Check


def check(
    tables: Tables,
    newton: Sequence[NewtonRow],
    printed: Sequence[DescentRow],
    literal: Sequence[DescentRow],
) -> tuple[Check, ...]:
    """The claims, judged."""
    iterations = [row.iterations for row in tables.table6]
    worst = {
        (r.motion, k): abs(d) for r in tables.table3 if r.quantity == "R_1" for k, d in enumerate(r.difference_deg)
    }
    theta6 = worst.pop(("I-1", 5))
    rounded = sum(abs(d) < 1e-9 for r in tables.table3 if r.quantity == "R_2" for d in r.difference_deg)
    miss = max(abs(d) for r in tables.table4 for d in r.difference_mm)
    same = sum(a == b for r in tables.table5 for a, b in zip(r.ours_mm, r.printed_mm, strict=True))
    chained = sum(a == b for r in tables.table5 for a, b in zip(r.from_table4_mm, r.printed_mm, strict=True))
    far = max(abs(a - b) for r in tables.table5 for a, b in zip(r.unrounded_mm, r.printed_mm, strict=True))
    steps = [row.iterations for row in newton]
    return (
        Check(
            "iterations equal the paper's",
            iterations == [row.printed_iterations for row in tables.table6],
            _join(iterations),
        ),
        Check(
            "R_1 within 2e-4 deg of Table 3 (theta_6 of I-1: 6e-4)",
            max(worst.values()) <= 2e-4 and theta6 <= 6e-4,
            f"{max(worst.values()):.1e} (theta_6 of I-1: {theta6:.1e})",
        ),
        Check("R_2 identical to Table 3", rounded == 42, f"{rounded} of 42 values"),
        Check("positions within 0.02 mm of Table 4", miss <= 0.02, f"{miss:.4f} mm"),
        Check(
            "Table 5 to two decimals, but for 6-I (misprint 10)",
            chained == 21 and same >= 19 and far <= 0.0151,
            f"{same} of 21 from our positions, {chained} of 21 from Table 4",
        ),
        Check(
            "Newton-Raphson solves all motions in at most 12 iterations",
            all(n is not None and n <= 12 for n in steps),
            _join(steps),
        ),
        _stalls("the printed settings do not converge", printed),
        _stalls("eq. (20) as printed does not converge", literal),
    )


def _stalls(claim: str, rows: Sequence[DescentRow]) -> Check:
    reached = sum(row.iterations is not None for row in rows)
    measured = f"{reached} of {len(rows)} runs within {rows[0].max_steps} iterations"
    return Check(claim, reached == 0, measured)


def _join(values: Sequence[int | None]) -> str:
    return ", ".join("never" if value is None else str(value) for value in values)
