"""Networks: plain torch modules that know nothing of training; inverters, and how they are stored."""

from __future__ import annotations

from ikgrad.networks.encodings import ENCODINGS, encode_pose
from ikgrad.networks.inverter import Inverter
from ikgrad.networks.local import IncrementInverter, UnrolledInverter
from ikgrad.networks.mlp import ACTIVATIONS, MLP, Activation
from ikgrad.networks.residual import ResidualMLP
from ikgrad.networks.scaling import MinMax
from ikgrad.networks.starts import BestOfStarts
from ikgrad.networks.storage import load_inverter, save_inverter

__all__ = [
    "ACTIVATIONS",
    "ENCODINGS",
    "Activation",
    "BestOfStarts",
    "IncrementInverter",
    "Inverter",
    "MLP",
    "MinMax",
    "ResidualMLP",
    "UnrolledInverter",
    "encode_pose",
    "load_inverter",
    "save_inverter",
]
