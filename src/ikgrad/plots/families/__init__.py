"""From a file to its figure: the families of inputs that ``ikgrad plot`` knows, each told by its content.

A new family is one module with a `Family`, one entry in `FAMILIES`, and one line in the help of the command.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ikgrad.errors import DataError, UnknownNameError
from ikgrad.files.peek import Peek, peek
from ikgrad.plots.families import bench, evaluations, joints, maps, poses, robots, runs, studies
from ikgrad.plots.families.base import Family, Found, Options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAMILIES: tuple[Family, ...] = (
    joints.FAMILY,
    poses.FAMILY,
    maps.FAMILY,
    runs.FAMILY,
    studies.FAMILY,
    evaluations.FAMILY,
    bench.FAMILY,
    robots.FAMILY,
)


class Recognised(NamedTuple):
    """Inputs whose family is known.

    Attributes:
        family: theirs.
        figures: what can be drawn from them, the default first.
    """

    family: Family
    figures: Found

    def choose(self, kind: str | None) -> str:
        """The kind of figure that is meant; the default for None.

        Raises:
            UnknownNameError: they have no such figure.
        """
        if kind is None:
            return next(iter(self.figures))
        if kind not in self.figures:
            raise UnknownNameError("kind of figure", kind, self.figures)
        return kind

    def draw(self, kind: str | None = None, options: Options | None = None) -> Figure:
        """Draw one figure."""
        return self.figures[self.choose(kind)](options or Options())


def recognise(paths: Sequence[str | Path]) -> Recognised:
    """Find out what inputs are.

    Args:
        paths: one file, folder or built-in robot, or several training runs.

    Raises:
        DataError: there is no such file, it is damaged, or nothing that can be drawn; several of a kind that is drawn
            one at a time.

    Example:
        >>> found = recognise(["panda"])
        >>> found.family.what, list(found.figures)
        ('a robot', ['arm'])
    """
    looks = [_look(path) for path in paths]
    for family in FAMILIES:
        first = family.find(looks[:1])
        if first is None:
            continue
        if len(looks) == 1:
            return Recognised(family, first)
        if not family.several:
            raise DataError(f"{looks[0].path}: is {family.what}; those are drawn one at a time, got {len(looks)}")
        return Recognised(family, family.find(looks) or first)
    raise DataError(f"{looks[0].path}: nothing to draw; known are {', '.join(family.what for family in FAMILIES)}")


def _look(path: str | Path) -> Peek:
    """A file or folder, or the name of a built-in robot."""
    if not Path(path).exists() and robots.is_built_in(str(path)):
        return Peek(Path(path), "robot")
    return peek(path)


__all__ = ["FAMILIES", "Options", "Recognised", "recognise"]
