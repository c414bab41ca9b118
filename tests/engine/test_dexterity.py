"""Condition number and manipulability against numpy's singular values."""

from __future__ import annotations

import numpy as np
import pytest

from ikgrad.engine.dexterity import dexterity


@pytest.mark.parametrize("n", [3, 6, 7, 9])
@pytest.mark.parametrize("k", [1, 3, 5, 6])
def test_equals_the_singular_values(n: int, k: int):
    random = np.random.default_rng(n * k)
    J, rows = random.normal(size=(50, 6, n)), random.normal(size=(k, 6))
    J[:25, :, -1] *= 1e-5
    found = dexterity(J, rows)
    s = np.linalg.svd(rows @ J, compute_uv=False)
    if k > n:
        assert (found == [np.inf, 0]).all()
    else:
        assert found[:, 0] == pytest.approx(s[:, 0] / s[:, -1], rel=1e-9)
        assert found[:, 1] == pytest.approx(s.prod(axis=1), rel=1e-9)


def test_a_singular_jacobian_has_no_end():
    J = np.zeros((2, 6, 6))
    J[1] = np.eye(6)
    J[1, 5] = J[1, 4]
    assert (dexterity(J, np.eye(6)) == [np.inf, 0]).all()


def test_threads_and_neighbours_do_not_matter():
    J = np.random.default_rng(0).normal(size=(9000, 6, 7))
    whole = dexterity(J, np.eye(6), threads=2)
    assert (whole[100:140] == dexterity(J[100:140], np.eye(6))).all()
