"""How good answers are: measured by forward kinematics that the answers had no part in, as plain records."""

from __future__ import annotations

from ikgrad.evaluation.errors import Errors, RowErrors, measure, row_errors
from ikgrad.evaluation.inverters import evaluate
from ikgrad.evaluation.paths import Line, Path
from ikgrad.evaluation.protocols import Global, IKFlow, Local
from ikgrad.evaluation.records import Answers, Evaluation, Protocol, Row
from ikgrad.evaluation.table import cells
from ikgrad.evaluation.tracik import TracIK

PROTOCOLS: dict[str, type[Protocol]] = {
    protocol.name: protocol for protocol in (Local, Global, IKFlow, TracIK, Path, Line)
}
"""By name, in the order of the report."""

__all__ = [
    "PROTOCOLS",
    "Answers",
    "Errors",
    "Evaluation",
    "Global",
    "IKFlow",
    "Line",
    "Local",
    "Path",
    "Protocol",
    "Row",
    "RowErrors",
    "TracIK",
    "cells",
    "evaluate",
    "measure",
    "row_errors",
]
