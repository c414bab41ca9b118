"""Data sets: samples, how they were made, for which robot, and which rows are for training, validation and test.

On disk a data set is one safetensors file; its header holds the recipe, the robot and a checksum as JSON. The same
recipe gives the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ikgrad.config.loading import check_values
from ikgrad.data.schemes import SCHEMES, Samples, Scheme
from ikgrad.errors import ConfigError, DataError, RobotError, UnknownNameError
from ikgrad.files.places import check_output, in_one_move
from ikgrad.robot import Robot

FORMAT = "ikgrad data 1"
PARTS = ("train", "validation", "test")


@dataclass(frozen=True, eq=False)
class DataSet:
    """Samples of a robot, split in three.

    Attributes:
        robot: whose they are.
        scheme: how they were made.
        samples: all rows, in the order of the scheme.
        part: (N,) 0, 1 or 2: training, validation or test.
    """

    robot: Robot
    scheme: Scheme
    samples: Samples
    part: Tensor

    @cached_property
    def train(self) -> Samples:
        """Rows to learn from."""
        return self._rows(0)

    @cached_property
    def validation(self) -> Samples:
        """Rows to stop by."""
        return self._rows(1)

    @cached_property
    def test(self) -> Samples:
        """Rows to judge by."""
        return self._rows(2)

    def _rows(self, part: int) -> Samples:
        return self.samples.rows((self.part == part).nonzero().squeeze(-1))

    @property
    def recipe(self) -> dict[str, Any]:
        """All that the rows depend on, the robot aside, as plain values."""
        counts = torch.bincount(self.part.long(), minlength=3).tolist()
        return {"scheme": self.scheme.NAME, **asdict(self.scheme), "split": dict(zip(PARTS, counts, strict=True))}

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write one safetensors file, in one move.

        Args:
            path: ends in ``.safetensors``.
            force: replace an existing file.

        Raises:
            DataError: the file exists, has another suffix, or cannot be written.

        Example:
            >>> import ikgrad as ik, tempfile
            >>> robot = ik.load_robot("ur5e")
            >>> data = generate(robot, ik.data.JointBox(count=20, seed=3))
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     again = DataSet.load(data.save(folder + "/mine.safetensors"), robot=robot)
            >>> again.scheme == data.scheme
            True
        """
        path = check_output(path, [".safetensors"], force=force)
        try:
            with in_one_move(path, force=force) as temporary:
                temporary.write_bytes(self.to_bytes())
        except OSError as error:
            raise DataError(f"{path}: cannot write the data: {error.strerror}") from error
        return path

    def to_bytes(self) -> bytes:
        """The content of the file that `save` writes."""
        from safetensors.torch import save

        copies = [part.clone(memory_format=torch.contiguous_format) for part in self.samples]  # they may share memory
        tensors = dict(zip(Samples._fields, copies, strict=True))
        tensors["part"] = self.part
        about = {
            "format": FORMAT,
            "robot": {"name": self.robot.name, "fingerprint": self.robot.fingerprint},
            "joint_names": list(self.robot.joint_names),
            "units": {"position": "m", "angle": "rad"},
            "recipe": self.recipe,
            "sha256": _checksum(tensors),
        }
        # one entry only: the order of several in the header is not fixed
        return save(tensors, metadata={"ikgrad": json.dumps(about, sort_keys=True)})

    @classmethod
    def load(cls, path: str | Path, *, robot: Robot) -> DataSet:
        """Read what `save` wrote.

        Args:
            path: the file.
            robot: the robot whose data they are to be.

        Raises:
            RobotError: they are another robot's.
            DataError: the file cannot be read, is damaged, empty, or holds a value that is not finite.
        """
        path = Path(path)
        about, tensors = _read(path)
        stored = about["robot"]
        if stored["fingerprint"] != robot.fingerprint:
            raise RobotError(
                f"{path}: data of robot '{stored['name']}' with fingerprint {stored['fingerprint']}, not of "
                f"'{robot.name}' with {robot.fingerprint}; load that robot, or generate the data anew"
            )
        _check(path, tensors, robot)
        recipe = {key: value for key, value in about["recipe"].items() if key != "split"}
        try:
            scheme = scheme_from_recipe(recipe)
        except (ConfigError, UnknownNameError) as error:
            raise DataError(f"{path}: the recipe cannot be understood: {error}") from error
        part = tensors.pop("part")
        return cls(robot, scheme, Samples(**tensors), part)


def generate(robot: Robot, scheme: Scheme, *, validation: float = 0.15, test: float = 0.15) -> DataSet:
    """Make a data set; the same arguments give the same bytes.

    Args:
        robot: the robot.
        scheme: how rows come about, with their number and seed.
        validation: share of the rows to stop by, drawn at random.
        test: share of the rows to judge by, drawn at random.

    Raises:
        ConfigError: shares that leave nothing to learn from, or a setting of the scheme that makes no sense.
        DataError: points that the robot cannot reach.

    Example:
        >>> import ikgrad as ik
        >>> data = generate(ik.load_robot("denso_vp6242"), ik.data.SmoothPath())
        >>> [len(part.q) for part in (data.train, data.validation, data.test)]
        [2800, 600, 600]
    """
    if min(validation, test) < 0 or validation + test >= 1:
        raise ConfigError(f"validation and test must be shares that leave some rows, got {validation} and {test}")
    generator = torch.Generator().manual_seed(scheme.seed)
    samples = scheme.draw(robot, generator)
    order = torch.randperm(scheme.count, generator=generator)
    counts = [round(share * scheme.count) for share in (validation, test)]
    part = torch.zeros(scheme.count, dtype=torch.uint8)
    part[order[: counts[0]]] = 1
    part[order[counts[0] : sum(counts)]] = 2
    return DataSet(robot, scheme, samples, part)


def scheme_from_recipe(recipe: Mapping[str, Any]) -> Scheme:
    """A scheme from plain values, its name under ``scheme``.

    Raises:
        UnknownNameError: no such scheme.
        ConfigError: a key that the scheme does not have, or a value that makes no sense.

    Example:
        >>> scheme_from_recipe({"scheme": "cube", "half_width": 0.03}).half_width
        0.03
    """
    values = dict(recipe)
    name = str(values.pop("scheme", ""))
    if name not in SCHEMES:
        raise UnknownNameError("sampling scheme", name, SCHEMES)
    return SCHEMES[name](**check_values(SCHEMES[name], values, where=f"scheme '{name}'"))


def _checksum(tensors: Mapping[str, Tensor]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(name.encode())
        digest.update(tensors[name].cpu().numpy().tobytes())
    return digest.hexdigest()


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        with safe_open(path, framework="pt") as file:
            about = json.loads((file.metadata() or {}).get("ikgrad", "null"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise DataError(f"{path}: is not a data file, or is damaged: {error}") from error
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise DataError(f"{path}: holds no data of this version of ikgrad (wanted: format '{FORMAT}')")
    missing = {"robot", "recipe", "sha256"} - about.keys() | {*Samples._fields, "part"} - tensors.keys()
    if missing:
        raise DataError(f"{path}: lacks {', '.join(sorted(missing))}; generate the data anew")
    if _checksum(tensors) != about["sha256"]:
        raise DataError(f"{path}: the numbers were changed since they were written (checksum); generate the data anew")
    return about, tensors


def _check(path: Path, tensors: Mapping[str, Tensor], robot: Robot) -> None:
    rows = len(tensors["q"])
    shapes = {"T": (rows, 4, 4), "q": (rows, robot.dof), "q_current": (rows, robot.dof), "part": (rows,)}
    for name, shape in shapes.items():
        if tensors[name].shape != shape:
            raise DataError(f"{path}: {name} must have shape {shape}, got {tuple(tensors[name].shape)}")
        if not tensors[name].isfinite().all():
            place = (~tensors[name].isfinite()).nonzero()[0].tolist()
            raise DataError(f"{path}: {name}{place} is not finite")
    if rows == 0:
        raise DataError(f"{path}: the data set is empty; there is nothing to learn from")


__all__ = ["DataSet", "generate", "scheme_from_recipe"]
