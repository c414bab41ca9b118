"""Distances between spheres and links, eight spheres at a time, and their vector-Jacobian product."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ikgrad.engine.cache import kernel, prepare
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.simd import W, get_lane, load, select, splat, sqrt, store

Array = NDArray[np.float64]
SHORT = float(np.finfo(np.float64).eps) ** 2  # squared length [m^2] up to which a link counts as a point
_WORK = 32768  # distances a chunk


@njit(forceinline=True)
def _link(links: Any, row: int) -> Any:
    """Start p, direction d and 1 / d.d (0 for a point) of a link."""
    i = 6 * row
    px, py, pz = links[i], links[i + 1], links[i + 2]
    dx, dy, dz = links[i + 3] - px, links[i + 4] - py, links[i + 5] - pz
    square = dx * dx + dy * dy + dz * dz
    return px, py, pz, dx, dy, dz, 1.0 / square if square > SHORT else 0.0


@njit(forceinline=True)
def _nearest(link: Any, spheres: Any, at: int, size: int) -> Any:
    """Parameter t of the nearest point on the link, and from there to the centres: v, in lanes."""
    px, py, pz, dx, dy, dz, inverse = link
    wx, wy, wz = load(spheres, at) - px, load(spheres, at + size) - py, load(spheres, at + 2 * size) - pz
    t = (wx * dx + wy * dy + wz * dz) * inverse
    t = select(t > 0.0, t, 0.0)
    t = select(t < 1.0, t, 1.0)
    return t, wx - t * dx, wy - t * dy, wz - t * dz


@kernel
def distance_rows(links: Any, spheres: Any, link_radius: Any, out: Any, first: int, last: int, count: int) -> None:
    """Signed distances (R, K) of links (R, 2, 3), rows first..last, to K spheres.

    ``spheres`` is (4, K rounded up to 8): x, y, z, radius, so that the last block may look past the end.
    """
    size, radii = spheres.size // 4, link_radius.size
    rest = np.empty(W)
    for row in range(first, last):
        link, thickness = _link(links, row), link_radius[row % radii]
        for at in range(0, count, W):
            _, vx, vy, vz = _nearest(link, spheres, at, size)
            distance = sqrt(vx * vx + vy * vy + vz * vz) - load(spheres, at + 3 * size) - thickness
            if at + W <= count:
                store(out, row * count + at, distance)
            else:
                store(rest, 0, distance)
                for i in range(count - at):
                    out[row * count + at + i] = rest[i]


@kernel
def distance_vjp_rows(links: Any, spheres: Any, g: Any, grad: Any, first: int, last: int, count: int) -> None:
    """Gradient (R, 2, 3) of a loss with respect to the links from its gradient g (R, K) by the distances.

    The nearest point moves along the link without changing the distance to first order, so only the pull
    g v / |v| remains, shared between the ends as 1 - t to t; zero where a centre lies on the link.
    """
    size = spheres.size // 4
    rest = np.zeros(W)
    for row in range(first, last):
        link = _link(links, row)
        ax, ay, az, bx, by, bz = splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0)
        for at in range(0, count, W):
            t, vx, vy, vz = _nearest(link, spheres, at, size)
            if at + W <= count:
                pull = load(g, row * count + at)
            else:
                for i in range(count - at):
                    rest[i] = g[row * count + at + i]
                pull = load(rest, 0)
            square = vx * vx + vy * vy + vz * vz
            apart = square > 0.0
            pull = select(apart, pull / sqrt(select(apart, square, 1.0)), 0.0)
            gx, gy, gz = pull * vx, pull * vy, pull * vz
            ax, ay, az, bx, by, bz = ax - gx, ay - gy, az - gz, bx - t * gx, by - t * gy, bz - t * gz
        ax, ay, az = ax - bx, ay - by, az - bz
        _sum_lanes((ax, ay, az, bx, by, bz), grad, 6 * row)


@njit(forceinline=True)
def _sum_lanes(vectors: Any, target: Any, at: int) -> None:
    for i in range(6):
        total = 0.0
        for lane in range(W):
            total += get_lane(vectors[i], lane)
        target[at + i] = total


def pack_spheres(centers: Array, radii: Array) -> Array:
    """Spheres (K, 3) and (K,) as the kernels read them: (4 * K rounded up to eight,)."""
    count = len(radii)
    packed = np.zeros((4, -(-count // W) * W))
    packed[:3, :count] = centers.T
    packed[3, :count] = radii
    return packed.reshape(-1)


def distances(links: Array, centers: Array, radii: Array, link_radius: Array, *, threads: int = 1) -> Array:
    """Signed distance between the surfaces of links and spheres.

    Args:
        links: (R, 2, 3) both ends of every link [m].
        centers: (K, 3) [m]
        radii: (K,) [m]
        link_radius: (r,) [m]; row i has number i modulo r.
        threads: threads to use.

    Returns:
        (R, K)
    """
    rows, count = len(links), len(radii)
    out = np.empty((rows, count))
    flat, into, run = np.ascontiguousarray(links).reshape(-1), out.reshape(-1), prepare(distance_rows)
    spheres, thickness = pack_spheres(centers, radii), np.ascontiguousarray(link_radius)
    chunk = max(1, _WORK // count)
    for_chunks(lambda a, b: run(flat, spheres, thickness, into, a, b, count), rows, chunk, threads)
    return out


def distances_vjp(links: Array, centers: Array, grad: Array, *, threads: int = 1) -> Array:
    """Gradient with respect to the links from the gradient (R, K) with respect to the `distances`.

    Returns:
        (R, 2, 3)
    """
    rows, count = len(links), len(centers)
    out = np.empty((rows, 2, 3))
    flat, into, run = np.ascontiguousarray(links).reshape(-1), out.reshape(-1), prepare(distance_vjp_rows)
    spheres, g = pack_spheres(centers, np.zeros(count)), np.ascontiguousarray(grad).reshape(-1)
    chunk = max(1, _WORK // count)
    for_chunks(lambda a, b: run(flat, spheres, g, into, a, b, count), rows, chunk, threads)
    return out
