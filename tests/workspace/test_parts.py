"""Orientations, cells and the spreading of answers, each for itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ikgrad.errors import ConfigError
from ikgrad.workspace import even_rotations
from ikgrad.workspace.flood import flood
from ikgrad.workspace.grid import FACES, ball


def largest_gap(R: np.ndarray) -> float:
    """How far any rotation can be from the nearest one of a set, over many random ones [rad]."""
    probes = Rotation.random(4000, random_state=1).as_matrix()
    cosine = (np.einsum("pij,oij->po", probes, R) - 1) / 2
    return float(np.arccos(cosine.max(axis=1).clip(-1, 1)).max())


@pytest.mark.parametrize("count", [1, 2, 50, 333])
def test_rotations_are_proper_and_always_the_same(count: int):
    R = even_rotations(count)
    assert R.shape == (count, 3, 3)
    assert (R @ R.mT - torch.eye(3)).abs().max() < 1e-14
    assert (torch.linalg.det(R) - 1).abs().max() < 1e-14
    assert torch.equal(R, even_rotations(count))


def test_rotations_leave_smaller_gaps_than_random_ones():
    random = [largest_gap(Rotation.random(200, random_state=k).as_matrix()) for k in range(5)]
    assert largest_gap(even_rotations(200).numpy()) < 0.9 * min(random)


def test_no_rotations_are_refused():
    with pytest.raises(ConfigError, match="orientations must be at least 1, got 0"):
        even_rotations(0)


def test_cells_fill_the_ball_and_know_their_neighbours():
    centre = np.array([0.03, -0.02, 0.4])
    grid = ball(centre, 0.35, 0.05)
    assert (np.linalg.norm(grid.centres - centre, axis=1) <= 0.35 + 1e-12).all()
    assert len(grid) * 0.05**3 == pytest.approx(4 / 3 * np.pi * 0.35**3, rel=0.02)
    number = {tuple(index): k for k, index in enumerate(grid.index.tolist())}
    for k, index in enumerate(grid.index.tolist()):
        beside = [number.get(tuple(np.add(index, face).tolist()), -1) for face in FACES]
        assert beside == grid.neighbours[k].tolist()


@pytest.mark.parametrize(
    ("cell", "message"),
    [(1e-4, r"fill the reach of 1 m with 4\.19e\+12; 2e\+07 fit in memory, from 0\.0059 m on"), (9.0, "no centre")],
)
def test_too_many_cells_or_none(cell: float, message: str):
    with pytest.raises(ConfigError, match=message):
        ball(np.full(3, 4.5), 1.0, cell)


def row_of(cells: int) -> np.ndarray:
    """Neighbours of cells in a row."""
    k = np.arange(cells)
    return np.stack([np.where(k + 1 < cells, k + 1, -1), k - 1], axis=1)


def test_answers_spread_over_what_is_wanted_and_solvable():
    reached = np.array([False, False, True, False, False, False, False, False])
    wanted = np.array([True, True, True, True, True, False, True, True])
    q = np.zeros((8, 1))
    q[2] = 7.0
    calls = []

    def attempt(cells: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.extend(cells.tolist())
        assert (starts >= 7).all()  # joints of a reached neighbour
        return cells != 0, starts + 1

    assert flood(reached, q, wanted, row_of(8), attempt) == len(calls) == 4
    assert reached.tolist() == [False, True, True, True, True, False, False, False]  # 5 is not wanted: nothing beyond
    assert q.flatten().tolist() == [0, 8, 7, 8, 9, 0, 0, 0]
    assert sorted(calls) == [0, 1, 3, 4]


def test_nothing_spreads_from_nothing():
    assert flood(np.zeros(5, dtype=bool), np.zeros((5, 2)), np.ones(5, dtype=bool), row_of(5), None) == 0  # type: ignore[arg-type]
