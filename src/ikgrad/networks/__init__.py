"""Networks: plain torch modules that know nothing of training."""

from __future__ import annotations

from ikgrad.networks.mlp import ACTIVATIONS, MLP, Activation
from ikgrad.networks.scaling import MinMax

__all__ = ["ACTIVATIONS", "Activation", "MLP", "MinMax"]
