"""Inverse kinematics for many targets at once, over numpy arrays."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ikgrad.engine.cache import prepare
from ikgrad.engine.parallel import for_chunks
from ikgrad.engine.solver import solve_rows
from ikgrad.engine.tables import PackedChain

Array = NDArray[np.float64]
_CHUNK = 2048
_NONE = np.empty(0)
_ONES = np.ones(6)


class Solved(NamedTuple):
    """What `solve` found, row by row."""

    q: Array  # (B, n) best joint values, inside the limits if they were asked for
    position_error: Array  # (B,) [m] at q; NaN if the target is not finite
    rotation_error: Array  # (B,) [rad]
    steps: NDArray[np.int64]  # (B,) damped steps, over all starts
    starts: NDArray[np.int64]  # (B,) starts tried
    converged: NDArray[np.bool_]  # (B,) both errors within tolerance


def solve(
    chain: PackedChain,
    T: Array,
    q0: Array | None = None,
    *,
    weights: Array | None = None,
    tol_pos: float = 1e-6,
    tol_rot: float = 1e-6,
    limits: bool = True,
    max_steps: int = 60,
    max_starts: int = 300,
    seed: int = 0,
    damping: float = 0.05,
    max_step: float = 0.8,
    stall: float = 0.7,
    patience: int = 5,
    near: float = 0.03,
    guesses: int = 8,
    threads: int = 1,
) -> Solved:
    """Levenberg-Marquardt from several starts until one reaches the target.

    Args:
        chain: from `pack`.
        T: (B, 4, 4) targets.
        q0: (B, n) first starts, clamped to the limits; without, the first start is the engine's choice.
        weights: (6,) weights of the error [linear; angular]; None: all 1. If they are not all 1, errors are taken
            along and about the axes of the target's own frame; a weight of 0 leaves that direction free and out of
            the errors.
        tol_pos: position tolerance [m].
        tol_rot: rotation tolerance [rad].
        limits: keep the joints inside their limits.
        max_steps: steps a start.
        max_starts: starts a row.
        seed: random starts are keyed by it and by the row's own content.
        damping: mu = damping |e|^2.
        max_step: largest change of a joint in a step [rad], for slides times the arm's typical length.
        stall: a start is given up when the error falls to no less than this fraction in three steps ...
        patience: ... after this many steps,
        near: ... unless its error is below this (rad, or typical lengths), which often is a slow end.
        guesses: starts taken from the robot's table of configurations before random ones.
        threads: threads to use.

    Returns:
        The best configuration of every row. Rows do not influence each other.
    """
    rows, n = len(T), len(chain.low)
    flat = np.ascontiguousarray(T, dtype=np.float64).reshape(-1)
    first = _NONE if q0 is None else np.ascontiguousarray(q0, dtype=np.float64).reshape(-1)
    masked = weights is not None and bool((weights != 1.0).any())
    weights = _ONES if weights is None else np.ascontiguousarray(weights, dtype=np.float64)
    constants = _constants(
        (tol_pos, tol_rot, damping, max_step, stall * stall, near * near),
        (seed & (2**63 - 1), max_steps, max_starts, limits, masked, patience, guesses),
    )
    q, errors, info = np.empty(rows * n), np.empty(rows * 2), np.empty(rows * 3, dtype=np.int64)
    run, tables = prepare(solve_rows), chain.solver_tables

    def work(a: int, b: int) -> None:
        run(*tables, flat, first, weights, *constants, q, errors, info, a, b)

    for_chunks(work, rows, _CHUNK, threads)
    error, count = errors.reshape(rows, 2), info.reshape(rows, 3)
    return Solved(q.reshape(rows, n), error[:, 0], error[:, 1], count[:, 0], count[:, 1], count[:, 2] != 0)


@functools.lru_cache(maxsize=64)
def _constants(settings: tuple[float, ...], counts: tuple[int, ...]) -> tuple[Array, NDArray[np.int64]]:
    """The settings as the kernel takes them; kept, because a call for one pose feels their making."""
    return np.array(settings, dtype=np.float64), np.array(counts, dtype=np.int64)
