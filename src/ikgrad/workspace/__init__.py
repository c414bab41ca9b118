"""Where an arm gets to: reach and manipulability over a grid of positions and orientations."""

from ikgrad.workspace.bounds import reach
from ikgrad.workspace.orientations import even_rotations
from ikgrad.workspace.result import WorkspaceMap
from ikgrad.workspace.survey import Survey, reachability

__all__ = ["Survey", "WorkspaceMap", "even_rotations", "reach", "reachability"]
