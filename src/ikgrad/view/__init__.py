"""The robot in a web page: joints to turn, a target to drag, methods to watch, motions to play.

What is shown is computed without viser and can be used and tested without it: `shapes` (the arm as capsules and
cylinders), `meshes` (as its URDF has it), `session` (what the arm does for a target, in words), `follow` (by which
method), `race` (methods on one target, iterate by iterate), `motion` and `paths` (joints of a file or of a study),
`obstacles` (spheres, and the clearance to them). `scene`, `stage`, `contest`, `panels`, `controls`, `app`, `server` and
`export` put it into viser's page and are all that needs the extra ``[viz]``.
"""

from ikgrad.view.app import Viewer
from ikgrad.view.export import export_page
from ikgrad.view.motion import Motion, read_motion
from ikgrad.view.race import Run, race
from ikgrad.view.server import start_server
from ikgrad.view.session import Answer, Session
from ikgrad.view.shapes import Part, arm_parts

__all__ = [
    "Answer",
    "Motion",
    "Part",
    "Run",
    "Session",
    "Viewer",
    "arm_parts",
    "export_page",
    "race",
    "read_motion",
    "start_server",
]
