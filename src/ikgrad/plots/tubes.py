"""A robot arm as a shaded mesh of tubes and balls, for pictures: numpy only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

LIGHT = np.array([0.35, -0.55, 0.75]) / np.linalg.norm([0.35, -0.55, 0.75])
SIDES = 20


class Mesh(NamedTuple):
    """Quadrilaterals with their brightness."""

    faces: np.ndarray  # (F, 4, 3) corners [m]
    shade: np.ndarray  # (F,) brightness, 0.55 to 1.1
    joint: np.ndarray  # (F,) bool: belongs to a ball, not to a tube


def arm_mesh(points: np.ndarray, radius: float, *, skip: np.ndarray | None = None) -> Mesh:
    """Tubes between successive points, thinner towards the tip, with a ball at every bend.

    Args:
        points: (k, 3) origins of the links from base to tip [m]; repeated points are drawn once.
        radius: of the first tube [m]; the last has 0.4 of it.
        skip: (k, 3) another pose of the same arm; tubes that both have are left out.
    """
    keep = [0]
    for k in range(1, len(points)):
        if np.linalg.norm(points[k] - points[keep[-1]]) > 1e-6:
            keep.append(k)
    xyz = points[keep]
    widths = radius * np.linspace(1.0, 0.4, len(xyz))
    other = np.full_like(xyz, np.inf) if skip is None else skip[keep]
    same = np.abs(xyz - other).max(axis=1) < 1e-6
    parts = [] if same[0] else [foot(xyz[0], 1.7 * radius)]
    for k in range(len(xyz) - 1):
        if not (same[k] and same[k + 1]):
            cut = 0.8 * widths[k : k + 2] * (k > 0, 1)
            start, end = _between_balls(xyz[k : k + 2], cut)
            parts.append(tube(start, end, widths[k], widths[k + 1]))
        if k > 0 and not same[k]:
            parts.append(ball(xyz[k], 1.3 * widths[k]))
    parts.append(ball(xyz[-1], 0.9 * widths[-1]))
    return Mesh(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _between_balls(ends: np.ndarray, cut: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of a tube moved inwards, so that no face of it lies inside a ball (depth sorting would show it)."""
    length = np.linalg.norm(ends[1] - ends[0])
    along = (ends[1] - ends[0]) / length
    cut = np.minimum(cut, 0.4 * length)
    return ends[0] + cut[0] * along, ends[1] - cut[1] * along


def tube(start: np.ndarray, end: np.ndarray, r_start: float, r_end: float) -> Mesh:
    """A conical tube between two points, cut into short rings so that depth sorting works."""
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, SIDES + 1)
    normal = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)  # (S + 1, 3)
    along = np.linspace(0, 1, max(2, int(np.linalg.norm(end - start) / 0.06)))[:, None, None]
    rings = start + along * (end - start) + (r_start + along * (r_end - r_start)) * normal
    return _quads(rings, np.broadcast_to(normal, rings.shape), joint=False)


def ball(centre: np.ndarray, radius: float) -> Mesh:
    """A sphere."""
    turn, tilt = np.meshgrid(np.linspace(0, 2 * np.pi, SIDES + 1), np.linspace(0, np.pi, SIDES // 2 + 1))
    normal = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=-1)
    return _quads(centre + radius * normal, normal, joint=True)


def foot(centre: np.ndarray, radius: float) -> Mesh:
    """A flat disc of some height below the first joint."""
    return tube(centre, centre + np.array([0, 0, radius * 0.5]), radius, radius * 0.62)


def shadow(faces: np.ndarray, height: float) -> np.ndarray:
    """Faces pressed flat onto the plane z = height, straight from above: (F, 4, 3) -> (F, 4, 3)."""
    flat = faces.copy()
    flat[..., 2] = height
    return flat


def _quads(rings: np.ndarray, normals: np.ndarray, *, joint: bool) -> Mesh:
    """Faces between neighbouring points of a (rows, columns, 3) grid."""
    corners = [rings[:-1, :-1], rings[1:, :-1], rings[1:, 1:], rings[:-1, 1:]]
    faces = np.stack(corners, axis=-2).reshape(-1, 4, 3)
    normal = (normals[:-1, :-1] + normals[1:, 1:]).reshape(-1, 3)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    shade = 0.72 + 0.38 * (normal @ LIGHT)
    return Mesh(faces, shade, np.full(len(faces), joint))
