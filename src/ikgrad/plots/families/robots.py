"""Robots: the arm with its frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Family, Found, Options
from ikgrad.resources import builtin_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def is_built_in(name: str) -> bool:
    """Whether a robot of this name comes with the package."""
    return name in builtin_names("urdf")


def find(looks: Sequence[Peek]) -> Found | None:
    """A built-in name, or an XML file with a robot in it."""
    look = looks[0]
    urdf = look.kind == ".xml" and "<robot" in look.path.read_text(encoding="utf-8", errors="replace")
    return {"arm": lambda options: _arm(look, options)} if urdf or look.kind == "robot" else None


def _arm(look: Peek, options: Options) -> Figure:
    from ikgrad.plots.arm import arm_frames
    from ikgrad.robot import load_robot

    robot = options.robot or load_robot(str(look.path))
    low, high = robot.sampling_range
    q = 0.5 * low + 0.5 * high if options.q is None else options.q
    return arm_frames(robot, q, title=f"{robot.name}: {robot.base} to {robot.tip}")


FAMILY = Family("a robot", find)
