"""How good answers are: measured by forward kinematics that the answers had no part in, as plain records."""

from __future__ import annotations

from ikgrad.evaluation.errors import Errors, measure
from ikgrad.evaluation.inverters import Evaluation, Row, evaluate

__all__ = ["Errors", "Evaluation", "Row", "evaluate", "measure"]
