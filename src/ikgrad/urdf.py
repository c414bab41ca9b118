"""From a URDF file to a `Robot`: yourdfpy parses, this module checks the tree and cuts out the chain."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikgrad.errors import RobotError, UnknownNameError
from ikgrad.garbage import no_collection
from ikgrad.robot import Robot
from ikgrad.segments import Segment, Variable, is_pose

if TYPE_CHECKING:
    import yourdfpy
    from yourdfpy.urdf import Joint

KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}


def read_urdf(path: Path, *, base: str | None = None, tip: str | None = None) -> Robot:
    """The chain between two links of a URDF file; see `ikgrad.load_robot`."""
    description = parse(path)
    tree = _Tree(path, description)
    base = tree.check_link(base or tree.root)
    tip = tree.check_link(tip or tree.only_leaf(base))
    segments, variables = _chain(tree, base, tip)
    if not variables:
        raise RobotError(f"{path}: no moving joint between base '{base}' and tip '{tip}'")
    return Robot(description.name or path.stem, base, segments, variables)


def parse(path: Path) -> yourdfpy.urdf.Robot:
    """The description that yourdfpy reads from the file, without meshes, scene or log output.

    Raises:
        RobotError: not there, not readable, not XML, or not a URDF.
    """
    if not path.is_file():
        raise RobotError(f"{path}: no such file (and no built-in robot of that name; `ikgrad robots` lists them)")
    _refuse_xacro(path)
    with no_collection():
        import yourdfpy

    try:
        with _quiet(), np.errstate(all="ignore"):
            urdf = yourdfpy.URDF.load(
                str(path),
                load_meshes=False,
                build_scene_graph=False,
                filename_handler=yourdfpy.filename_handler_null,
            )
    except Exception as error:  # the parser raises whatever the broken text leads it into
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise RobotError(f"{path}: not a readable URDF ({reason})") from error
    return urdf.robot


def _refuse_xacro(path: Path) -> None:
    """Macros that are not expanded would be skipped by the parser, and links with them."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror or error}") from error
    if b"<xacro:" in re.sub(rb"<!--.*?-->", b"", text, flags=re.DOTALL):
        raise RobotError(f"{path}: is a xacro file; expand it first: xacro {path.name} > arm.urdf")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the parser's log messages (its own recovery attempts) off the terminal."""
    logger = logging.getLogger("yourdfpy.urdf")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


class _Tree:
    """Links and joints by name, checked to be one tree (the parser accepts any graph)."""

    def __init__(self, path: Path, description: yourdfpy.urdf.Robot):
        self.path = path
        self.links = [link.name for link in description.links]
        self.joints = {joint.name: joint for joint in description.joints}
        self.parent_joint: dict[str, Joint] = {}
        self._check_names([joint.name for joint in description.joints])
        if not self.joints:
            raise RobotError(f"{path}: has no joints")
        for joint in description.joints:
            self._add(joint)
        self.root = self._find_root()

    def _check_names(self, joints: list[str]) -> None:
        for kind, names in (("link", self.links), ("joint", joints)):
            twice = {name for name in names if names.count(name) > 1}
            if twice:
                raise RobotError(f"{self.path}: {kind} name '{min(twice)}' is used more than once")
        if not self.links:
            raise RobotError(f"{self.path}: has no links")

    def _add(self, joint: Joint) -> None:
        for link in (joint.parent, joint.child):
            if link not in self.links:
                raise RobotError(f"{self.path}: joint '{joint.name}' refers to link '{link}', which does not exist")
        if joint.child in self.parent_joint:
            other = self.parent_joint[joint.child].name
            raise RobotError(
                f"{self.path}: link '{joint.child}' has two parent joints, '{other}' and '{joint.name}' (a closed "
                "chain; only trees are supported)"
            )
        self.parent_joint[joint.child] = joint

    def _find_root(self) -> str:
        connected = {name for joint in self.joints.values() for name in (joint.parent, joint.child)}
        roots = [link for link in self.links if link in connected and link not in self.parent_joint]
        if not roots:
            raise RobotError(f"{self.path}: the joints form a cycle, there is no root link")
        for link in connected:
            self.way_to_root(link)
        if len(roots) > 1:
            raise RobotError(f"{self.path}: has more than one root link: {', '.join(roots)}")
        return roots[0]

    def way_to_root(self, link: str) -> list[str]:
        """Links from ``link`` up to the root, both included."""
        way = [link]
        while way[-1] in self.parent_joint:
            way.append(self.parent_joint[way[-1]].parent)
            if len(way) > len(self.links):
                raise RobotError(f"{self.path}: the joints form a cycle through link '{link}'")
        return way

    def check_link(self, name: str) -> str:
        if name not in self.links:
            raise UnknownNameError(f"link of {self.path.name}", name, self.links)
        return name

    def only_leaf(self, base: str) -> str:
        parents = {joint.parent for joint in self.joints.values()}
        leaves = [link for link in self.links if link not in parents and base in self.way_to_root(link)[1:]]
        if len(leaves) != 1:
            what = f"{len(leaves)} leaf links below '{base}'"
            raise RobotError(f"{self.path}: {what}; choose one with tip=... (--tip): {', '.join(leaves) or 'none'}")
        return leaves[0]

    def master(self, joint: Joint) -> tuple[Joint, float, float]:
        """The joint that a mimic joint follows in the end, with multiplier and offset."""
        multiplier, offset, seen = 1.0, 0.0, [joint.name]
        while joint.mimic is not None:
            name = joint.mimic.joint
            if name not in self.joints or name in seen:
                reason = "mimics itself" if name in seen else f"mimics joint '{name}', which does not exist"
                raise RobotError(f"{self.path}: joint '{seen[0]}' {reason}")
            offset += multiplier * joint.mimic.offset
            multiplier *= joint.mimic.multiplier
            joint = self.joints[name]
            seen.append(name)
        return joint, multiplier, offset


def _chain(tree: _Tree, base: str, tip: str) -> tuple[tuple[Segment, ...], tuple[Variable, ...]]:
    """Up from the base to the common ancestor (joints reversed), then down to the tip."""
    up, down = tree.way_to_root(base), tree.way_to_root(tip)
    if up[-1] != down[-1]:
        raise RobotError(f"{tree.path}: base '{base}' and tip '{tip}' are not connected")
    shared = next(link for link in up if link in down)
    segments: list[Segment] = []
    variables: dict[str, Variable] = {}
    for link in up[: up.index(shared)]:
        joint = tree.parent_joint[link]
        motion = _segment(tree, joint, variables)
        back = Segment(f"{joint.name}_back", joint.parent, np.linalg.inv(motion.origin))
        axis = (-motion.axis[0], -motion.axis[1], -motion.axis[2])
        segments += [motion._replace(link=None, origin=np.eye(4), axis=axis), back]
    for link in reversed(down[: down.index(shared)]):
        segments.append(_segment(tree, tree.parent_joint[link], variables))
    return tuple(segments), tuple(variables.values())


def _segment(tree: _Tree, joint: Joint, variables: dict[str, Variable]) -> Segment:
    where = f"{tree.path}: joint '{joint.name}'"
    if joint.type not in KINDS:
        raise RobotError(f"{where} is of kind '{joint.type}'; on the way to the tip only {', '.join(KINDS)} work")
    origin = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64)
    if not is_pose(origin):
        raise RobotError(f"{where} has an origin that is not finite")
    if KINDS[joint.type] == "fixed":
        return Segment(joint.name, joint.child, origin)
    axis, norm = np.asarray(joint.axis, dtype=np.float64), np.linalg.norm(joint.axis)
    if axis.shape != (3,) or not np.isfinite(norm) or norm == 0:
        raise RobotError(f"{where} has the axis {axis.tolist()}, which has no direction")
    master, multiplier, offset = tree.master(joint)
    if KINDS.get(master.type) not in ("revolute", "prismatic"):
        raise RobotError(f"{where} mimics '{master.name}', which is of kind '{master.type}' and does not move")
    variables.setdefault(master.name, _variable(tree, master))
    x, y, z = (float(value) for value in axis / norm)
    index = list(variables).index(master.name)
    return Segment(joint.name, joint.child, origin, KINDS[joint.type], (x, y, z), index, multiplier, offset)


def _variable(tree: _Tree, joint: Joint) -> Variable:
    kind, limit = KINDS[joint.type], joint.limit
    if joint.type == "continuous" or limit is None or (limit.lower is None and limit.upper is None):
        return Variable(joint.name, kind, -np.inf, np.inf)
    low = 0.0 if limit.lower is None else float(limit.lower)  # the URDF specification's default
    high = 0.0 if limit.upper is None else float(limit.upper)
    if np.isnan([low, high]).any() or low > high:
        raise RobotError(f"{tree.path}: joint '{joint.name}' has limits {low:g} to {high:g}: swapped or not numbers")
    return Variable(joint.name, kind, low, high)
