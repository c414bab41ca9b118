"""Optimizers by name: ours, and every class of `torch.optim` that takes any dense parameter."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import nn

from ikgrad import optim
from ikgrad.config.loading import unknown_key
from ikgrad.errors import ConfigError, UnknownNameError

MakeOptimizer = Callable[[Sequence[nn.Parameter], int], torch.optim.Optimizer]

_OURS: dict[str, type[torch.optim.Optimizer]] = {
    "levenberg_marquardt": optim.LevenbergMarquardt,
    "backprop": optim.Backprop,
    "delta_bar_delta": optim.DeltaBarDelta,
    "quickprop": optim.Quickprop,
}
_UNFIT = {
    "Optimizer",
    "SparseAdam",
    "Muon",
}  # sparse gradients; matrices only, and stacked weights have three dimensions
_MIX = {"LBFGS", "Adafactor"}  # look at all weights together, so that stacked networks would disturb each other


def optimizer_names() -> list[str]:
    """What can be asked for, ours first."""
    torchs = [name for name, cls in vars(torch.optim).items() if _is_optimizer(cls) and name not in _UNFIT]
    return [*_OURS, *sorted(torchs)]


def make_optimizer(name: str, *, lr: float | None = None, options: Mapping[str, Any] | None = None) -> MakeOptimizer:
    """A function that makes the optimizer over the parameters of S stacked networks.

    Args:
        name: one of `optimizer_names`.
        lr: learning rate; None: the optimizer's default.
        options: further arguments, lists where it wants tuples.

    Raises:
        UnknownNameError: no such optimizer.
        ConfigError: an option that it does not have, a value that it refuses, or no lr where it needs one.

    Example:
        >>> make = make_optimizer("Adam", lr=0.01, options={"betas": [0.8, 0.99]})
        >>> make([nn.Parameter(torch.zeros(2))], 1).defaults["betas"]
        (0.8, 0.99)
    """
    known = optimizer_names()
    if name not in known:
        raise UnknownNameError("optimizer", name, known)
    cls = _OURS.get(name) or getattr(torch.optim, name)
    settings = _settings(name, cls, lr, dict(options or {}))

    def make(parameters: Sequence[nn.Parameter], members: int) -> torch.optim.Optimizer:
        stacked: dict[str, Any] = {"members": members} if cls is optim.LevenbergMarquardt else {}
        return cls(list(parameters), **settings, **stacked)

    try:
        make([nn.Parameter(torch.zeros(1, 1, 1, dtype=torch.float64))], 1)
    except (ValueError, TypeError, RuntimeError) as error:
        raise ConfigError(f"optimizer '{name}' refuses its settings: {error}") from error
    return make


def side_by_side(name: str) -> bool:
    """Whether stacked networks learn as they would alone."""
    return name not in _MIX


def _settings(name: str, cls: type, lr: float | None, options: dict[str, Any]) -> dict[str, Any]:
    parameters = inspect.signature(cls).parameters
    known = {key: value for key, value in parameters.items() if key not in ("params", "members", "lr")}
    for key in options:
        if key == "lr":
            raise ConfigError("optimizer_options: give the learning rate as lr, a key of its own")
        if key not in known:
            raise ConfigError(f"optimizer_options: optimizer '{name}': {unknown_key(key, known)}")
    if lr is not None and "lr" not in parameters:
        raise ConfigError(f"lr must be null: optimizer '{name}' has no learning rate, got {lr}")
    if lr is None and "lr" in parameters and parameters["lr"].default is inspect.Parameter.empty:
        raise ConfigError(f"lr must be given: optimizer '{name}' has no learning rate of its own")
    settings = {key: tuple(value) if isinstance(value, list) else value for key, value in options.items()}
    return settings if lr is None else {**settings, "lr": lr}


def _is_optimizer(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, torch.optim.Optimizer)


__all__ = ["MakeOptimizer", "make_optimizer", "optimizer_names", "side_by_side"]
