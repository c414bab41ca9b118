"""Cubic cells inside a ball, and which of them touch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikgrad.errors import ConfigError

MOST_CELLS = 20_000_000
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells by their centres, in lattice order.

    Attributes:
        cell: edge of a cell [m].
        index: (C, 3) int32; the centre is ``cell * index``, so that maps of one cell size share a lattice.
        neighbours: (C, 6) int32, the cells across the six `FACES`; -1 where there is none.
    """

    cell: float
    index: np.ndarray
    neighbours: np.ndarray

    @property
    def centres(self) -> np.ndarray:
        """Centres (C, 3) [m]."""
        return self.cell * self.index

    def __len__(self) -> int:
        return len(self.index)


def ball(centre: np.ndarray, radius: float, cell: float) -> Grid:
    """The cells whose centres lie in a ball.

    Args:
        centre: (3,) of the ball [m].
        radius: [m]
        cell: edge of a cell [m].

    Raises:
        ConfigError: too many cells, or none.

    Example:
        >>> len(ball(np.zeros(3), 0.1, 0.1))
        7
    """
    expected = 4 / 3 * math.pi * (radius / cell) ** 3
    if expected > MOST_CELLS:
        least = cell * (expected / MOST_CELLS) ** (1 / 3)
        raise ConfigError(
            f"cells of {cell:g} m fill the reach of {radius:.3g} m with {expected:.3g}; "
            f"{MOST_CELLS:.0e} fit in memory, from {least:.2g} m on"
        )
    low = np.floor((centre - radius) / cell).astype(int)
    shape = np.ceil((centre + radius) / cell).astype(int) - low + 1
    index = np.indices(shape, dtype=np.int32).reshape(3, -1).T
    inside = np.linalg.norm(cell * (index + low) - centre, axis=1) <= radius * (1 + 1e-12)
    if not inside.any():
        raise ConfigError(f"no centre of a cell of {cell:g} m lies within the reach of {radius:.3g} m")
    number = np.full(len(index), -1, dtype=np.int32)
    number[inside] = np.arange(inside.sum())
    index = index[inside]
    neighbours = [_numbers(number, index + np.array(face), shape) for face in FACES]
    return Grid(cell, (index + low).astype(np.int32), np.stack(neighbours, axis=1))


def _numbers(number: np.ndarray, index: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Numbers of the cells at places of the box; -1 outside."""
    within = np.all((index >= 0) & (index < shape), axis=1, keepdims=True)
    place = np.ravel_multi_index(tuple(np.where(within, index, 0).T), tuple(shape))
    return np.where(within[:, 0], number[place], -1).astype(np.int32)
