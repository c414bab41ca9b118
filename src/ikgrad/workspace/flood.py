"""Answers spread from cell to cell: where a neighbour was reached, its joints are the best start there is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Attempt = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def flood(reached: np.ndarray, q: np.ndarray, wanted: np.ndarray, neighbours: np.ndarray, attempt: Attempt) -> int:
    """Try each wanted cell from the joints of its reached neighbours, until that reaches no more cells.

    Every newly reached cell is passed on once to each of its neighbours, so the work is that of the boundary alone.

    Args:
        reached: (C,) bool, changed.
        q: (C, n) joints of the reached cells, changed.
        wanted: (C,) bool, cells worth trying.
        neighbours: (C, k) numbers of touching cells, -1 for none.
        attempt: takes (B,) cells and (B, n) starts, answers with (B,) bool and (B, n) joints.

    Returns:
        How many attempts were made.
    """
    attempts, fresh = 0, np.flatnonzero(reached)
    while len(fresh):
        found = []
        for side in range(neighbours.shape[1]):
            cells = neighbours[fresh, side]
            open_ = (cells >= 0) & wanted[cells] & ~reached[cells]
            cells, starts = cells[open_], q[fresh[open_]]
            if not len(cells):
                continue
            attempts += len(cells)
            met, joints = attempt(cells, starts)
            hit = cells[met]
            q[hit], reached[hit] = joints[met], True
            found.append(hit)
        fresh = np.concatenate(found) if found else np.empty(0, dtype=np.int64)
    return attempts
