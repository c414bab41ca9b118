"""The meshes that a URDF names for its links, read from files.

trimesh reads them; it comes with yourdfpy, together with all that it needs for STL, OBJ, DAE, GLB and PLY. A link
whose mesh cannot be had is drawn as capsules, and one line says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ikgrad.errors import ConfigError
from ikgrad.robot import Robot
from ikgrad.urdf import parse
from ikgrad.view.meshfile import Piece, UnreadableError, find_mesh, read_mesh, simplified
from ikgrad.view.shapes import Triangles

if TYPE_CHECKING:
    import yourdfpy.urdf as yd

MOST_FACES = 300_000  # of a whole arm: about 6 MB that go to every page
PLAIN = (200, 200, 205)  # where neither URDF nor file names a colour


class Visual(NamedTuple):
    """What is drawn of one link in one colour.

    Attributes:
        link: index in ``robot.link_names``.
        mesh: in the frame of that link [m].
        colour: three bytes.
    """

    link: int
    mesh: Triangles
    colour: tuple[int, int, int]


class Look(NamedTuple):
    """An arm's own look.

    Attributes:
        visuals: all that could be read.
        missing: indices of links whose meshes could not be had.
        notes: one line for each kind of trouble.
    """

    visuals: tuple[Visual, ...]
    missing: frozenset[int]
    notes: tuple[str, ...]


def read_look(urdf: str | Path, robot: Robot, folder: str | Path, *, most_faces: int = MOST_FACES) -> Look:
    """The visual meshes of an arm, boxes, cylinders and spheres included.

    Links that hang rigidly on the arm, such as a gripper, are drawn too, and movable ones behind them as at zero.
    Textures are not read. More than ``most_faces`` triangles are made fewer by moving near corners together.

    Args:
        urdf: the file that the robot was loaded from.
        robot: the robot.
        folder: under which the meshes lie. Of ``package://a/b/c.stl`` (or any other path) ``a/b/c.stl`` is looked
            for there first, then ``b/c.stl``, then ``c.stl``.
        most_faces: see above.

    Raises:
        ConfigError: the folder does not exist, or the file names no meshes for this arm.
        RobotError: the URDF cannot be read.
    """
    folder, description = Path(folder), parse(Path(urdf))
    if not folder.is_dir():
        raise ConfigError(f"--meshes {folder}: no such folder")
    pieces: list[tuple[int, Piece]] = []
    trouble: dict[str, list[str]] = {}
    missing: set[int] = set()
    for link, place, name, visual in _visuals(description, robot):
        try:
            own = _colour(visual, description)
            read = _pieces(visual.geometry, Path(urdf).parent, folder)
            pieces += [(link, piece.moved(place @ _origin(visual)).tinted(own)) for piece in read]
        except UnreadableError as error:
            missing.add(link)
            trouble.setdefault(error.kind, []).append(f"{name}: {error}")
    if not pieces and not trouble:
        raise ConfigError(f"{urdf}: names no meshes for the links of this arm; leave --meshes out")
    count = sum(len(piece.mesh.faces) for _, piece in pieces)
    if count > most_faces:
        trouble["simplified"] = [f"{count:,} triangles are more than {most_faces:,} and were made fewer"]
        pieces = [(link, simplified(piece, most_faces / count)) for link, piece in pieces]
    return Look(tuple(_merged(pieces)), frozenset(missing), tuple(_notes(trouble)))


def _notes(trouble: dict[str, list[str]]) -> Iterator[str]:
    for kind, lines in trouble.items():
        if kind == "simplified":
            yield lines[0]
            continue
        more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        yield f"{lines[0]}{more}; drawn as capsules"


def _visuals(description: yd.Robot, robot: Robot) -> Iterator[tuple[int, np.ndarray, str, Any]]:
    """Every visual: the arm's link that carries it, where that link has it, the name of its own link, and itself."""
    links = {link.name: link for link in description.links}
    neighbours: dict[str, list[tuple[str, np.ndarray]]] = {}
    for joint in description.joints:
        T = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64)
        neighbours.setdefault(joint.parent, []).append((joint.child, T))
        neighbours.setdefault(joint.child, []).append((joint.parent, np.linalg.inv(T)))
    reached = set(robot.link_names)
    for index, name in enumerate(robot.link_names):
        waiting = [(name, np.eye(4))]
        while waiting:
            at, T = waiting.pop()
            if at in links:  # a tool that was added has no link in the file
                yield from ((index, T, at, visual) for visual in links[at].visuals)
            for other, step in neighbours.get(at, []):
                if other not in reached:
                    reached.add(other)
                    waiting.append((other, T @ step))


def _origin(visual: yd.Visual) -> np.ndarray:
    return np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)


def _colour(visual: yd.Visual, description: yd.Robot) -> tuple[int, int, int] | None:
    """What the URDF says, None if it says nothing."""
    material = visual.material
    if material is not None and material.color is None:  # by name, defined elsewhere
        material = next((m for m in description.materials if m.name == material.name), None)
    if material is None or material.color is None or material.color.rgba is None:
        return None
    red, green, blue = (round(255 * float(part)) for part in material.color.rgba[:3])
    return red, green, blue


def _pieces(geometry: yd.Geometry, beside: Path, folder: Path) -> list[Piece]:
    """A file's meshes, or a simple body's."""
    import trimesh

    if geometry.mesh is not None:
        found = read_mesh(find_mesh(geometry.mesh.filename, beside, folder))
        scale = np.diag([*np.broadcast_to(1.0 if geometry.mesh.scale is None else geometry.mesh.scale, 3), 1.0])
        return [piece.moved(scale) for piece in found]
    if geometry.box is not None:
        body = trimesh.creation.box(np.asarray(geometry.box.size, dtype=np.float64))
        body.unmerge_vertices()  # flat sides
    elif geometry.cylinder is not None:
        body = trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length, sections=48)
        body = trimesh.graph.smooth_shade(body, angle=0.5)
    elif geometry.sphere is not None:
        body = trimesh.creation.icosphere(subdivisions=3, radius=geometry.sphere.radius)
    else:
        raise UnreadableError("body", "has a body of a kind that is not drawn")
    return [Piece(Triangles(np.asarray(body.vertices), np.asarray(body.faces)), None)]


def _merged(pieces: list[tuple[int, Piece]]) -> Iterator[Visual]:
    """One mesh for each link and colour: a page draws few large ones faster than many small ones."""
    groups: dict[tuple[int, tuple[int, int, int]], list[Triangles]] = {}
    for link, piece in pieces:
        groups.setdefault((link, piece.colour or PLAIN), []).append(piece.mesh)
    for (link, colour), meshes in groups.items():
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)
        faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
        yield Visual(link, Triangles(vertices, faces.astype(np.uint32)), colour)


__all__ = ["Look", "Visual", "read_look"]
