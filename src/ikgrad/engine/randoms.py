"""Random numbers that depend on what they are for and on nothing else (counter-based, splitmix64).

A row's numbers are keyed by the seed and by the row's own content, so they do not change with its place in a batch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_STEP = np.uint64(0x9E3779B97F4A7C15)
_A, _B = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@njit(forceinline=True)
def mix(key: Any, value: Any) -> Any:
    """A new 64-bit key from a key and a value (splitmix64's finaliser)."""
    z = (key ^ value) + _STEP
    z = (z ^ (z >> _S30)) * _A
    z = (z ^ (z >> _S27)) * _B
    return z ^ (z >> _S31)


@njit(forceinline=True)
def mix_floats(key: Any, values: Any, first: int, last: int, word: Any) -> Any:
    """A new key from the bits of ``values[first:last]``; -0.0 counts as 0.0. ``word`` is (1,) float64 scratch."""
    as_bits = word.view(np.uint64)
    for i in range(first, last):
        word[0] = values[i] + 0.0
        key = mix(key, as_bits[0])
    return key


@njit(forceinline=True)
def unit(key: Any) -> float:
    """A number in [0, 1) from a key."""
    return np.float64(key >> _S11) * (1.0 / 9007199254740992.0)
