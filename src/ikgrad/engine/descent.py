"""Training rules for one weight of eight networks: what a gradient does to a weight and to the rule's memory.

Each is called as ``rule(settings, memory, at, size, w, g)`` and returns the new weights, a Vec. ``memory`` holds the
rule's quantities one after the other, ``size`` numbers each; those of this weight stand at ``at``, ``at + size`` and so
on. The equations are with the optimizers of the same names in `ikgrad.optim`, whose arithmetic is repeated here case by
case, so that a lane that is NaN or infinite goes the same way.
"""

from __future__ import annotations

from typing import Any

from numba import njit

from ikgrad.engine.simd import load, select, store


@njit(forceinline=True)
def backprop(settings: Any, memory: Any, at: Any, size: Any, w: Any, g: Any) -> Any:
    """Settings (lr, momentum); memory: momentum buffer."""
    lr, momentum = settings
    if momentum > 0.0:
        g = load(memory, at) * momentum + g
        store(memory, at, g)
    return w - g * lr


@njit(forceinline=True)
def delta_bar_delta(settings: Any, memory: Any, at: Any, size: Any, w: Any, g: Any) -> Any:
    """Settings (schedule, kappa, phi, theta, momentum); memory: rate, trace, last step."""
    schedule, kappa, phi, theta, momentum = settings
    rate, trace = load(memory, at), load(memory, at + size)
    against = _along(g, trace)
    rate = select(against < 0.0, rate + kappa, select(against > 0.0, rate * (1.0 - phi), rate))
    store(memory, at, rate)
    store(memory, at + size, trace * theta + g * (1.0 - theta))
    step = (rate * g) * -schedule
    if momentum > 0.0:
        step = load(memory, at + 2 * size) * momentum + step
        store(memory, at + 2 * size, step)
    return w + step


@njit(forceinline=True)
def quickprop(settings: Any, memory: Any, at: Any, size: Any, w: Any, g: Any) -> Any:
    """Settings (lr, mu, weight decay, max step); memory: last step, last slope."""
    lr, mu, weight_decay, max_step = settings
    last_step, last_slope = load(memory, at), load(memory, at + size)
    slope = g + w * weight_decay
    now = _along(slope, last_step)
    limited = now >= _along(last_slope, last_step) * (mu / (1.0 + mu))
    jump = select(limited, mu, slope / select(limited, 1.0, last_slope - slope)) * last_step
    step = jump - select((now > 0.0) | (last_step == 0.0), slope * lr, 0.0)
    step = select(step < -max_step, -max_step, select(step > max_step, max_step, step))
    store(memory, at, step)
    store(memory, at + size, slope)
    return w + step


@njit(forceinline=True)
def _along(slope: Any, step: Any) -> Any:
    """Steepness along a step: the slope with the sign that makes downhill positive; 0 without a step."""
    return select(step > 0.0, -slope, select(step < 0.0, slope, slope * 0.0))


@njit(forceinline=True)
def printed_quickprop(settings: Any, memory: Any, at: Any, size: Any, w: Any, g: Any) -> Any:
    """Quickprop with ``literal=True``. Settings (lr,); memory: last step, last slope."""
    last_step = load(memory, at)
    jump = g / (load(memory, at + size) - g) * last_step
    step = select(last_step == 0.0, 0.0, jump) - g * settings[0]
    store(memory, at, step)
    store(memory, at + size, g)
    return w + step
