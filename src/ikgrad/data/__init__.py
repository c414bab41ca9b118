"""Data to learn inverse kinematics from: configurations, sampling schemes, data sets that know how they were made."""

from __future__ import annotations

from ikgrad.data.configurations import sample_configurations
from ikgrad.data.dataset import DataSet, generate
from ikgrad.data.schemes import SCHEMES, Cube, Helix, JointBox, Samples, Scheme, SmoothPath
from ikgrad.data.stream import TaskStream

__all__ = [
    "SCHEMES",
    "Cube",
    "DataSet",
    "Helix",
    "JointBox",
    "Samples",
    "Scheme",
    "SmoothPath",
    "TaskStream",
    "generate",
    "sample_configurations",
]
