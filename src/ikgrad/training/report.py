"""What run.json says of every training, and devices that are not there."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from typing import Any

import torch

from ikgrad import __version__
from ikgrad.config.training import AnyConfig
from ikgrad.errors import ConfigError
from ikgrad.robot import Robot
from ikgrad.training.processes import world_size
from ikgrad.training.run_folder import FORMAT


def describe_run(
    config: AnyConfig, robot: Robot, state: str, seconds: float, manifest: Mapping[str, Any]
) -> dict[str, Any]:
    """State, seeds, robot, versions, machine: plain values for JSON."""
    return {
        "format": FORMAT,
        "state": state,
        "seed": config.seed,
        "robot": {"name": robot.name, "fingerprint": robot.fingerprint},
        "seconds": seconds,
        "versions": {"ikgrad": __version__, "torch": str(torch.__version__), "python": platform.python_version()},
        "platform": {
            "system": platform.platform(),
            "machine": platform.machine(),
            "device": config.device,
            "threads": torch.get_num_threads(),
            "processes": world_size(),
        },
        "manifest": dict(manifest),
    }


def check_device(device: str) -> None:
    """Refuse a GPU that is not there.

    Raises:
        ConfigError: torch sees no CUDA device, or not that one.
    """
    if device == "cpu":
        return
    if not torch.cuda.is_available():
        raise ConfigError(f"device '{device}': torch sees no CUDA device here; take cpu")
    index, count = torch.device(device).index or 0, torch.cuda.device_count()
    if index >= count:
        raise ConfigError(f"device '{device}': torch sees {count} CUDA devices here, the last is cuda:{count - 1}")


__all__ = ["check_device", "describe_run"]
