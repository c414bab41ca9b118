"""The misprints of the paper, each with what shows it."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ikgrad.papers.denso.arm import MatrixRow, dh_matrices, home_companions
from ikgrad.papers.printed import numbers, read_table
from ikgrad.papers.record import Erratum


def errata(matrices: Sequence[MatrixRow]) -> tuple[Erratum, ...]:
    """All of them, evidence computed where numbers can show it."""
    d6_wrong = next(row for row in matrices if row.note.startswith("with Table 1's"))
    home = next(row for row in matrices if row.at == "q_home")
    product = torch.linalg.multi_dot(list(dh_matrices(d6=0.17)))[:3, 3].tolist()
    place = "(" + ", ".join(f"{x:.3g}" for x in product) + ")"
    found = [
        ("eq. (2)", "Trans_{x, d_i}", "Trans_{z, d_i}", "the expanded matrix of the same equation has d in row z"),
        (
            "A_6 against Table 1",
            "0.17 and 0.07",
            "0.07 flange + 0.10 gripper",
            f"with 0.07 A_6 is off by {d6_wrong.difference:g} m; with 0.17 T_home is met to {home.difference:.0e}",
        ),
        ("A_gripper, eq. (4)", "no numbers", "Trans_z(0.10)", "inferred: the only one that gives T_home"),
        (
            "T_home from the given joints",
            "matrices at q = 0",
            "q_home = (0, 90, 180, 0, -90, 0) deg",
            f"the printed matrices multiply to {place} m and no rotation",
        ),
        ("inputs of the network", "13", "12", "eq. (10): 3 + 3 + 6; 13 with a quaternion or a bias"),
        (
            '"hidden layers is ten"',
            "ten layers",
            "ten neurons in one layer",
            "Table 3 counts 20 to 30 of them elsewhere",
        ),
        ("helix", "no centre", "an offset in front of the arm", "as printed it circles the base axis"),
        ("Table 2 against the text", "percent and mm", "no common reference length", _reference_lengths()),
        (
            "Table 3, PUMA row",
            "6.42, 4.90, 2.92 %",
            "4.93, 7.29, 3.73 %, or not",
            "the introduction quotes the same source so; MSE 1.217 against 1.2178",
        ),
        (
            '"unique" joints for a position',
            "unique",
            "within one branch of solutions",
            f"{len(home_companions())} different joint vectors give the pose of home",
        ),
        ("d_1", "0.125", "kept", "the real shoulder is likely higher, but only 0.125 gives T_home"),
        ("text", "HD parameters", "DH parameters", "reading"),
    ]
    return tuple(Erratum(number, *entry) for number, entry in enumerate(found, start=1))


def _reference_lengths() -> str:
    """What 100 % would have to be for every axis and network, if millimetres and percent spoke of the same errors."""
    percent = {row["parameter"][1]: row for row in read_table("denso_table2")[:3]}
    lengths = []
    for row in read_table("denso_path_errors"):
        mm = numbers(row, "proposed_max_error_mm", "traditional_max_error_mm")
        share = numbers(percent[row["axis"]], "proposed", "traditional")
        ours, theirs = (100 * a / b for a, b in zip(mm, share, strict=True))
        lengths.append(f"{row['axis']} {ours:.0f} and {theirs:.0f} mm")
    return "100 % would be " + ", ".join(lengths)


__all__ = ["errata"]
