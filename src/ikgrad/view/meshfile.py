"""One mesh file: found under a folder, read, made smaller."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ikgrad.view.shapes import Triangles

KINDS = (".stl", ".obj", ".dae", ".glb", ".gltf", ".ply", ".off")
CREASE = 0.6  # rad; sharper edges than this stay edges under light
LEAST_FACES = 60  # a piece is not made coarser than this

Colour = tuple[int, int, int]


class UnreadableError(Exception):
    """A mesh that cannot be drawn; ``kind`` groups like troubles."""

    def __init__(self, kind: str, text: str):
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangles of one colour, None where the file names none."""

    mesh: Triangles
    colour: Colour | None

    def moved(self, T: np.ndarray) -> Piece:
        """Under an affine map (4, 4); faces of a mirrored mesh are turned, so that they still look outwards."""
        faces = self.mesh.faces[:, ::-1] if np.linalg.det(T[:3, :3]) < 0 else self.mesh.faces
        return replace(self, mesh=Triangles(self.mesh.vertices @ T[:3, :3].T + T[:3, 3], faces))

    def tinted(self, colour: Colour | None) -> Piece:
        """With the URDF's colour, if it has one."""
        return self if colour is None else replace(self, colour=colour)


def find_mesh(name: str, beside: Path, folder: Path) -> Path:
    """The file that a URDF means, under a folder and nowhere else.

    Args:
        name: as in the URDF, with ``package://`` or ``file://`` or without.
        beside: the folder of the URDF, for relative names.
        folder: where the meshes lie.

    Raises:
        UnreadableError: not there.
    """
    plain = re.sub(r"^[a-z]+://", "", name).replace("\\", "/")
    parts = [part for part in PurePosixPath(plain).parts if part not in ("/", ".", "..")]
    root = folder.resolve()
    exact = [beside / plain] if "://" not in name or name.startswith("file://") else []
    for path in (*exact, *(folder.joinpath(*parts[k:]) for k in range(len(parts)))):
        if path.is_file() and path.resolve().is_relative_to(root):
            return path
    raise UnreadableError("missing", f"'{name}' is not under {folder}")


def read_mesh(path: Path) -> list[Piece]:
    """The triangles of a file [m], one piece for each colour that it names.

    The unit of a DAE file counts, its "up" axis does not, as elsewhere in robotics; the others have no unit.

    Raises:
        UnreadableError: of another kind, broken or empty.
    """
    import trimesh

    if path.suffix.lower() not in KINDS:
        raise UnreadableError("kind", f"{path.name} is of a kind that is not read (known: {', '.join(KINDS)})")
    log = logging.getLogger("trimesh")
    before, log.disabled = log.disabled, True
    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:  # a loader raises whatever the broken file leads it into
        raise UnreadableError("broken", f"{path.name} cannot be read ({type(error).__name__}: {error})") from error
    finally:
        log.disabled = before
    pieces = []
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        body = scene.geometry[name]
        if isinstance(body, trimesh.Trimesh) and len(body.faces):
            unit = np.diag([*[_unit(path)] * 3, 1.0])
            pieces.append(Piece(_shaded(body, path), _own_colour(body)).moved(unit @ T))
    if not pieces:
        raise UnreadableError("empty", f"{path.name} holds no triangles")
    return pieces


def _unit(path: Path) -> float:
    """Metres a unit, which trimesh does not look at."""
    if path.suffix.lower() != ".dae":
        return 1.0
    found = re.search(rb'<unit[^>]*\bmeter="([0-9.eE+-]+)"', path.read_bytes()[:20_000])
    return float(found[1]) if found else 1.0


def _shaded(body: Any, path: Path) -> Triangles:
    """Corners shared where light shall run smoothly. STL shares none: there edges are found by their angle."""
    import trimesh

    if path.suffix.lower() == ".stl":
        body.merge_vertices()
        body = trimesh.graph.smooth_shade(body, angle=CREASE)
    return Triangles(np.asarray(body.vertices, dtype=np.float64), np.asarray(body.faces))


def _own_colour(body: Any) -> Colour | None:
    if not body.visual.defined:
        return None
    paint = body.visual.material if body.visual.kind == "texture" else body.visual
    red, green, blue = (int(part) for part in paint.main_color[:3])
    return red, green, blue


def simplified(piece: Piece, share: float) -> Piece:
    """About so large a share of the triangles: corners in one cell of a grid become one.

    Args:
        piece: a mesh.
        share: of its triangles to be kept, 0 to 1; a few dozen are kept in any case.
    """
    vertices, wanted = piece.mesh.vertices, max(share * len(piece.mesh.faces), LEAST_FACES)
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    mesh, cells = piece.mesh, 512.0
    while len(mesh.faces) > wanted and cells > 4:
        _, first, index = np.unique(
            ((vertices - low) / (size / cells)).round().astype(np.int64), axis=0, return_index=True, return_inverse=True
        )
        faces = index.reshape(-1)[piece.mesh.faces]
        mesh = Triangles(vertices[first], faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)])
        cells *= 0.8
    return replace(piece, mesh=mesh)


__all__ = ["KINDS", "Piece", "UnreadableError", "find_mesh", "read_mesh", "simplified"]
