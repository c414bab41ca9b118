"""What the studies share: text tables for people, claims with their verdicts, misprints with their evidence."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

from ikgrad.training.threads import one_thread

Cells = tuple[str, ...]


class Table(NamedTuple):
    """A table of text; columns after the first ``left`` ones hold numbers."""

    title: str
    columns: Cells
    rows: tuple[Cells, ...]
    left: int = 1

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        cells = [[escape(cell) for cell in row] for row in (self.columns, *self.rows)]
        head, *body = ("".join(f"<td>{cell}</td>" for cell in row) for row in cells)
        rows = "".join(f"<tr>{row}</tr>" for row in body)
        return (
            f"<table><caption>{escape(self.title)}</caption><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        )


@dataclass(frozen=True)
class Check:
    """One claim about the reproduction, and whether it holds."""

    claim: str
    holds: bool
    measured: str


@dataclass(frozen=True)
class Erratum:
    """One misprint: what stands in the paper, what is right, and what shows it."""

    number: int
    where: str
    printed: str
    right: str
    evidence: str


def checks_table(checks: tuple[Check, ...]) -> Table:
    """What is claimed, and whether it holds."""
    rows = [("yes" if check.holds else "NO", check.claim, check.measured) for check in checks]
    return Table("Does it reproduce?", ("", "claim", "measured"), tuple(rows), left=3)


def misprints_table(errata: tuple[Erratum, ...]) -> Table:
    """The misprints with their evidence."""
    rows = [(str(e.number), e.where, e.printed, e.right, e.evidence) for e in errata]
    return Table("Misprints", ("", "where", "printed", "right", "evidence"), tuple(rows), left=5)


def plain(value: Any) -> Any:
    """Tuples as lists, so that a round trip through JSON changes nothing."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


__all__ = ["Cells", "Check", "Erratum", "Table", "checks_table", "misprints_table", "one_thread", "plain"]
