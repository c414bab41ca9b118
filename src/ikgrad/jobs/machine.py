"""What the bits of an answer depend on besides the question: versions, and what the processor can do."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from typing import Any

from ikgrad.errors import ConfigError
from ikgrad.files.partial import differences


def machine() -> dict[str, Any]:
    """Versions and processor, as a job's description has them.

    The kernels do the same arithmetic in registers of any width, so of all that a processor may have, only the fused
    multiply-add matters, which rounds once instead of twice.

    Example:
        >>> list(machine())
        ['ikgrad version', 'torch version', 'numpy version', 'numba version', 'pyarrow version', 'processor']
    """
    import numba
    import numpy
    import pyarrow
    import torch

    from ikgrad import __version__

    packages = {"torch": torch, "numpy": numpy, "numba": numba, "pyarrow": pyarrow}
    versions = {f"{name} version": str(package.__version__) for name, package in packages.items()}
    return {"ikgrad version": __version__, **versions, "processor": _processor()}


def check_machine(job: Mapping[str, Any]) -> None:
    """Refuse to work on a job that another kind of machine began: the partitions would not be of one kind.

    Raises:
        ConfigError: with what differs.
    """
    here = machine()
    differs = differences({name: job.get(name) for name in here}, here)
    if differs:
        raise ConfigError(f"{platform.node()}: this machine would give other bits than the job's: {'; '.join(differs)}")


def _processor() -> str:
    from llvmlite import binding  # type: ignore[import-untyped]

    features = binding.get_host_cpu_features()
    fused = features.get("fma", False) or platform.machine().lower() in {"arm64", "aarch64"}
    return platform.machine() + (" with fused multiply-add" if fused else "")
