"""Settings: flat frozen dataclasses, and `load_config`, which fills one from a YAML file.

Nothing here imports torch, so that a command can check its settings before anything heavy is loaded.
"""

from __future__ import annotations

from ikgrad.config.loading import load_config
from ikgrad.config.stream import StreamConfig
from ikgrad.config.studies import AppsConfig, DensoConfig, PumaConfig, RuleConfig, TrajectoryConfig
from ikgrad.config.training import TrainConfig

__all__ = [
    "AppsConfig",
    "DensoConfig",
    "PumaConfig",
    "RuleConfig",
    "StreamConfig",
    "TrainConfig",
    "TrajectoryConfig",
    "load_config",
]
