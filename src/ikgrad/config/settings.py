"""What the settings of all trainings share."""

from __future__ import annotations

import re
from typing import Any

from ikgrad.config.loading import require


class TrainingSettings:
    """Behaviour of frozen dataclasses with ``robot``, ``seed``, ``members`` and ``device``."""

    robot: str
    seed: int
    members: int
    device: str

    @property
    def seeds(self) -> range:
        """One for each member."""
        return range(self.seed, self.seed + self.members)

    def to_yaml(self) -> str:
        """The settings as a YAML file that gives the same settings again."""
        from yaml import safe_dump  # type: ignore[import-untyped]

        values = {key: _plain(value) for key, value in vars(self).items()}
        nested = any(isinstance(value, dict | list) for value in values.values())
        style = None if nested else False  # None would put a mapping of scalars alone into one pair of braces
        return safe_dump(values, sort_keys=False, default_flow_style=style, allow_unicode=True, width=120)

    def _check_shared(
        self, *, counts: tuple[str, ...], positive: tuple[str, ...], seeds_end: int, end_says: str
    ) -> None:
        """Refuse what is out of range; ``counts`` and ``positive`` may be None."""
        require(self.robot != "", "robot", "must be the name of a built-in robot or the path of a URDF file", "nothing")
        for key in ("members", *counts):
            value = getattr(self, key)
            require(value is None or value > 0, key, "must be at least 1", value)
        require(0 <= self.seed <= seeds_end - self.members, "seed", f"must be from 0 to {end_says}", self.seed)
        for key in positive:
            value = getattr(self, key)
            require(value is None or 0 < value < float("inf"), key, "must be positive and finite", value)
        device = re.fullmatch(r"cpu|cuda(:\d+)?", self.device)
        require(device is not None, "device", "must be cpu, cuda or cuda:N", repr(self.device))


def _plain(value: Any) -> Any:
    """Tuples as lists, which YAML knows."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


__all__ = ["TrainingSettings"]
