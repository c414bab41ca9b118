"""What a family is: files of one kind, and the figures that can be drawn from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ikgrad.errors import ConfigError
from ikgrad.files.peek import Peek

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from torch import Tensor

    from ikgrad.robot import Robot


@dataclass(frozen=True)
class Options:
    """What a figure may need besides the file.

    Attributes:
        robot: whose joints or poses they are.
        q: (n,) joints [rad or m].
    """

    robot: Robot | None = None
    q: Tensor | None = None

    def need_robot(self, why: str) -> Robot:
        """The robot.

        Raises:
            ConfigError: there is none.
        """
        if self.robot is None:
            raise ConfigError(f"{why} needs the robot: --robot NAME or URDF file")
        return self.robot


Draw = Callable[[Options], "Figure"]
Found = Mapping[str, Draw]
"""Kind of figure to what draws it; the first one is the default."""


@dataclass(frozen=True)
class Family:
    """One kind of input.

    Attributes:
        what: its name for people, with the article.
        find: the figures of these inputs, or None if they are of another family. Cheap: drawing reads the rest.
        several: it takes several inputs at a time.
    """

    what: str
    find: Callable[[Sequence[Peek]], Found | None]
    several: bool = False


__all__ = ["Draw", "Family", "Found", "Options"]
