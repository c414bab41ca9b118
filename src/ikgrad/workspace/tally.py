"""What a map keeps of each cell while orientation after orientation goes by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikgrad.workspace.search import Layer

Columns = dict[str, np.ndarray]


@dataclass(eq=False)
class Tally:
    """Sums and bests over the orientations so far, one row a cell."""

    tried: np.ndarray  # (C,) int32, orientations that are not out of reach for certain
    reached: np.ndarray  # (C,) int32
    condition: np.ndarray  # (C,) the smallest; infinite where nothing was reached
    manipulability: np.ndarray  # (C,) the largest; 0 where nothing was reached
    orientation: np.ndarray  # (C,) int32, number of the orientation with the smallest condition number; -1
    q: np.ndarray  # (C, n) joints there; NaN
    solutions: np.ndarray  # (C,) int64, summed over the orientations reached
    most: np.ndarray  # (C,) int32, solutions of one orientation

    @classmethod
    def empty(cls, cells: int, n: int) -> Tally:
        """Nothing seen yet."""
        zero, none = np.zeros(cells, dtype=np.int32), np.full(cells, -1, dtype=np.int32)
        condition, manipulability, q = np.full(cells, np.inf), np.zeros(cells), np.full((cells, n), np.nan)
        return cls(zero, zero.copy(), condition, manipulability, none, q, np.zeros(cells, dtype=np.int64), zero.copy())

    def add(self, number: int, layer: Layer, cells: np.ndarray, dexterity: np.ndarray, solutions: np.ndarray) -> None:
        """Count one more orientation.

        Args:
            number: of the orientation.
            layer: what was found.
            cells: (B,) those reached.
            dexterity: (B, 2) condition number and manipulability there.
            solutions: (B,) different solutions there.
        """
        self.tried += layer.wanted
        self.reached[cells] += 1
        self.solutions[cells] += solutions
        self.most[cells] = np.maximum(self.most[cells], solutions)
        self.manipulability[cells] = np.maximum(self.manipulability[cells], dexterity[:, 1])
        better = (dexterity[:, 0] < self.condition[cells]) | (self.orientation[cells] < 0)
        best = cells[better]
        self.condition[best], self.orientation[best], self.q[best] = dexterity[better, 0], number, layer.q[best]
