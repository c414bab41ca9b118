"""The look of an arm that has no meshes: capsules for the links, cylinders along the joint axes, rails for slides.

Every part is rigid in one link, so a page that holds the meshes needs the poses of the links and nothing else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ikgrad.plots.tubes import Mesh, ball, foot, tube
from ikgrad.robot import Robot

THICKNESS = 0.028  # radius of a link, as a share of the robot's length
JOINT = 1.45  # radius of a joint's cylinder, in radii of a link
FLAT = 1e-4  # height of a disc, in radii: a tube must have some length
RAIL = 0.5  # how far a rail without an end is drawn [m]


class Part(NamedTuple):
    """A capsule, or a cylinder with flat ends.

    Attributes:
        link: index in ``robot.link_names`` of the link that carries it.
        start: (3,) in the frame of that link [m].
        end: (3,) likewise.
        radius: [m]
        role: "link", "joint" or "rail".
    """

    link: int
    start: np.ndarray
    end: np.ndarray
    radius: float
    role: str


class Triangles(NamedTuple):
    """A mesh as web pages draw it."""

    vertices: np.ndarray  # (V, 3) float32 [m]
    faces: np.ndarray  # (F, 3) uint32, counter-clockwise from outside


def link_radius(robot: Robot) -> float:
    """How thick the links are drawn [m]."""
    return THICKNESS * robot.length


def arm_parts(robot: Robot) -> tuple[Part, ...]:
    """The arm, from its kinematics alone.

    Moving frame k carries a capsule to the origin of joint k + 1 (the last one: to the tip), and the cylinder of
    joint k about its axis. A slide runs on a rail as long as its range.

    Args:
        robot: the robot.

    Example:
        >>> import ikgrad as ik
        >>> parts = arm_parts(ik.load_robot("ur5e"))
        >>> sorted({part.role for part in parts}), sum(part.role == "joint" for part in parts)
        (['joint', 'link'], 6)
    """
    tables = robot.detach().tables()
    ends = torch.cat([tables.origins[:, :3, 3], tables.tool[None, :3, 3]]).numpy()  # (m + 1, 3), each in its frame
    radius = link_radius(robot)
    parts = []
    for k, end in enumerate(ends):
        if np.linalg.norm(end) > 1e-6:
            parts.append(_carried(robot, k, np.zeros(3), end, radius, "link"))
    for k, axis in enumerate(tables.axes.numpy()):
        half = JOINT * radius * axis
        parts.append(_carried(robot, k + 1, -half, half, JOINT * radius, "joint"))
        if bool(tables.prismatic[k]):
            parts.append(_rail(robot, k, radius))
    return tuple(parts)


def _rail(robot: Robot, k: int, radius: float) -> Part:
    """The way of slide k, in the frame before it."""
    tables = robot.detach().tables()
    variable = robot.variables[int(tables.variable[k])]
    ends = np.clip([variable.q_min, variable.q_max], -RAIL, RAIL) if _endless(variable.q_min, variable.q_max) else (
        np.array([variable.q_min, variable.q_max])
    )  # fmt: skip
    low, high = sorted(float(tables.multiplier[k]) * ends + float(tables.offset[k]))
    origin = tables.origins[k].numpy()
    along = origin[:3, :3] @ tables.axes[k].numpy()
    room = 1e-3 if high - low < 1e-3 else 0.0
    return _carried(robot, k, origin[:3, 3] + low * along, origin[:3, 3] + (high + room) * along, 0.45 * radius, "rail")


def _endless(low: float, high: float) -> bool:
    return not (np.isfinite(low) and np.isfinite(high))


def _carried(robot: Robot, frame: int, start: np.ndarray, end: np.ndarray, radius: float, role: str) -> Part:
    """A part given in a moving frame (0: the base), handed to the first link that the frame carries."""
    tables = robot.detach().tables()
    link = int(torch.nonzero(tables.link_frame == frame)[0])
    back = torch.linalg.inv(tables.link_offset[link]).numpy()
    return Part(link, back[:3, :3] @ start + back[:3, 3], back[:3, :3] @ end + back[:3, 3], radius, role)


def segments(parts: tuple[Part, ...], poses: Tensor) -> Tensor:
    """Where the axes of the parts are: (parts, 2, 3) ends in the base [m], for distances.

    Args:
        parts: L parts of `arm_parts`.
        poses: (links, 4, 4) of `ikgrad.link_poses`.
    """
    ends = torch.from_numpy(np.stack([np.stack([part.start, part.end]) for part in parts])).to(poses)
    T = poses[[part.link for part in parts]]
    return ends @ T[:, :3, :3].mT + T[:, None, :3, 3]


def part_mesh(part: Part) -> Triangles:
    """The surface of a part: round ends for links, flat ones for joints and rails."""
    side = tube(part.start, part.end, part.radius, part.radius)
    if part.role == "link":
        return merge([solid(piece) for piece in (side, ball(part.start, part.radius), ball(part.end, part.radius))])
    along = (part.end - part.start) / np.linalg.norm(part.end - part.start)
    caps = [_disc(part.start, -along, part.radius), _disc(part.end, along, part.radius)]
    return merge([solid(piece) for piece in (side, *caps)], inside=(part.start + part.end) / 2)


def base_mesh(radius: float) -> Triangles:
    """What the arm stands on: a flat cone below the first joint.

    Args:
        radius: of a link [m].
    """
    return merge(
        [solid(foot(np.zeros(3), 2.2 * radius)), solid(_disc(np.zeros(3), np.array([0, 0, -1.0]), 2.2 * radius))]
    )


def _disc(centre: np.ndarray, up: np.ndarray, radius: float) -> Mesh:
    return tube(centre, centre + FLAT * radius * up, radius, FLAT * radius)


def solid(mesh: Mesh) -> Triangles:
    """Quadrilaterals as triangles with shared corners (so that light runs smoothly), turned outwards."""
    corners = mesh.faces.reshape(-1, 3)
    _, first, index = np.unique(corners.round(9), axis=0, return_index=True, return_inverse=True)
    quads = index.reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)  # at a pole two corners are one
    return Triangles(corners[first], faces[different])


def merge(pieces: list[Triangles], *, inside: np.ndarray | None = None, turn: bool = True) -> Triangles:
    """Several meshes as one.

    Args:
        pieces: each convex, if they are turned.
        inside: (3,) a point that all faces shall look away from; default: the middle of each piece.
        turn: make the faces look outwards; False: they do already.
    """
    vertices, faces, count = [], [], 0
    for piece in pieces:
        middle = piece.vertices.mean(axis=0) if inside is None else inside
        faces.append((_outwards(piece, middle) if turn else piece.faces) + count)
        vertices.append(piece.vertices)
        count += len(piece.vertices)
    return Triangles(np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.uint32))


def _outwards(piece: Triangles, middle: np.ndarray) -> np.ndarray:
    corners = piece.vertices[piece.faces]  # (F, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wrong = ((corners.mean(axis=1) - middle) * normal).sum(axis=1) < 0
    return np.where(wrong[:, None], piece.faces[:, ::-1], piece.faces)
