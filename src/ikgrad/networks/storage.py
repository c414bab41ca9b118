"""Inverters on disk: a folder with ``model.safetensors`` and ``config.json``, and every reason to refuse one.

The configuration says what the weights are for: the robot by name, fingerprint, joints, base and tip; units and
features; the family, and its sizes and activations; the checksum of the weights file; and the versions that wrote it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

from ikgrad import __version__
from ikgrad.errors import DataError, RobotError, UnknownNameError
from ikgrad.networks.encodings import roll_pitch_yaw
from ikgrad.networks.inverter import Inverter
from ikgrad.networks.local import IncrementInverter, UnrolledInverter
from ikgrad.networks.places import CONFIG, WEIGHTS, find_inverter
from ikgrad.robot import Robot, load_robot
from ikgrad.segments import Segment

FORMAT = "ikgrad inverter 1"
_KEYS = ("format", "robot", "units", "features", "network", "weights_sha256", "versions")
_ROBOT_KEYS = ("name", "fingerprint", "joint_names", "base", "tip", "q_min", "q_max")
_CLASSIC = "classic"  # also of folders that were written before there was another family
_FAMILIES: dict[str, tuple[type, tuple[str, ...]]] = {
    _CLASSIC: (Inverter, ("feedback", "hidden", "activation", "encoding", "bounded", "dtype")),
    IncrementInverter.family: (IncrementInverter, ("width", "depth", "activation")),
    UnrolledInverter.family: (UnrolledInverter, ("rounds", "damping", "width", "depth", "activation")),
}
AnyInverter = Inverter | IncrementInverter


def save_inverter(inverter: AnyInverter, folder: str | Path, *, force: bool = False) -> Path:
    """Write an inverter; the folder appears whole or not at all.

    Args:
        inverter: what to write.
        folder: made anew; its parent must exist.
        force: replace a folder that holds an inverter.

    Returns:
        The folder.

    Raises:
        DataError: the folder exists, holds something else, or cannot be written.

    Example:
        >>> import ikgrad as ik, tempfile, torch
        >>> robot = ik.load_robot("denso_vp6242")
        >>> q = ik.sample_configurations(robot, 50, seed=0)
        >>> T = ik.forward_kinematics(robot, q)
        >>> inverter = ik.Inverter(robot).fit(T, q)
        >>> with tempfile.TemporaryDirectory() as parent:
        ...     again = ik.load_inverter(inverter.save(parent + "/mine"))
        >>> torch.equal(again(T), inverter(T))
        True
    """
    from safetensors.torch import save

    weights = save({name: tensor.detach().cpu().contiguous() for name, tensor in inverter.state_dict().items()})
    folder = Path(folder)
    _refuse_folder(folder, force)
    try:
        with _in_one_move(folder) as temporary:
            _write(temporary / WEIGHTS, weights)
            config = {**_describe(inverter), "weights_sha256": hashlib.sha256(weights).hexdigest()}
            _write(temporary / CONFIG, (json.dumps(config, indent=1) + "\n").encode())
    except OSError as error:
        raise DataError(f"{folder}: cannot write the inverter: {error.strerror}") from error
    return folder


def load_inverter(path: str | Path, *, robot: Robot | None = None) -> AnyInverter:
    """Read an inverter of any family that its ``save`` wrote, for the very robot that it was trained for.

    Args:
        path: the folder, or a run folder of `ikgrad train`; else the name of a built-in robot for which weights come
            with the package. An existing folder goes before such a name.
        robot: the robot it shall serve; default: the built-in robot of the stored name, base and tip.

    Raises:
        RobotError: the weights belong to another robot, or to another version of it; the message says what differs.
        UnknownNameError: no folder, and no weights of this name come with the package.
        DataError: a file is missing, truncated, changed, or lacks a part.

    Example:
        >>> import ikgrad as ik
        >>> inverter = ik.load_inverter("panda")
        >>> T, _, q_current = ik.data.TaskStream(inverter.robot, batch_size=4).batch(0)
        >>> inverter(T, q_current).shape
        torch.Size([4, 7])
    """
    path = find_inverter(path)
    config = _read_config(path / CONFIG)
    robot = _builtin_robot(path, config["robot"]) if robot is None else robot
    _compare(path, config["robot"], robot)
    state = _read_weights(path / WEIGHTS, config["weights_sha256"])
    try:
        inverter = _make(robot, config)
        if list(inverter.feature_names) != config["features"]:
            raise ValueError("features of other names")
        _check_sizes(state, inverter)
        inverter.load_state_dict(state)
    except (ValueError, TypeError, AttributeError, LookupError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{path}: the weights do not fit the configuration: {reason}") from error
    if isinstance(inverter, Inverter):
        inverter._find_reference = False
    return inverter


def _make(robot: Robot, config: Mapping[str, Any]) -> AnyInverter:
    """An inverter of the stored shape; whatever is wrong with the settings comes out as an error of its own."""
    settings = dict(config["network"])
    if "dtype" in settings:
        settings["dtype"] = getattr(torch, settings["dtype"])
    return _FAMILIES[config.get("family", _CLASSIC)][0](robot, **settings)


def _check_sizes(state: Mapping[str, torch.Tensor], inverter: torch.nn.Module) -> None:
    wanted = inverter.state_dict()
    for name in sorted(wanted.keys() | state.keys()):
        have, want = (str(tuple(part[name].shape)) if name in part else "nothing" for part in (state, wanted))
        if have != want:
            raise ValueError(f"{name} is {have} in the weights and {want} by the configuration")


def _describe(inverter: AnyInverter) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "robot": _describe_robot(inverter.robot),
        "units": {"position": "m", "angle": "rad"},
        "features": list(inverter.feature_names),
        "family": _CLASSIC if isinstance(inverter, Inverter) else inverter.family,
        "network": _classic_settings(inverter) if isinstance(inverter, Inverter) else inverter.settings(),
        "versions": {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
    }


def _describe_robot(robot: Robot) -> dict[str, Any]:
    return {
        "name": robot.name,
        "fingerprint": robot.fingerprint,
        "joint_names": list(robot.joint_names),
        "base": robot.base,
        "tip": robot.tip,
        "q_min": [_text(v.q_min) for v in robot.variables],
        "q_max": [_text(v.q_max) for v in robot.variables],
        "geometry": [_geometry(segment) for segment in robot.segments],
    }


def _geometry(segment: Segment) -> str:
    """Where a joint sits and how it moves, in words that a person can compare with the URDF."""
    origin = torch.from_numpy(segment.origin)
    parts = (origin[:3, 3].tolist(), roll_pitch_yaw(origin[:3, :3]).tolist(), segment.axis)
    xyz, rpy, axis = (" ".join(f"{x + 0.0:.9g}" for x in part) for part in parts)
    text = f"{segment.joint} xyz {xyz} rpy {rpy}"
    if segment.kind == "fixed":
        return text
    return f"{text}, {segment.kind} by {segment.multiplier:g} q {segment.offset:+g} along {axis}"


def _classic_settings(inverter: Inverter) -> dict[str, Any]:
    network = inverter.network
    return {
        "feedback": inverter.feedback,
        "hidden": list(network.sizes[1:-1]),
        "activation": network.hidden,
        "encoding": inverter.encoding,
        "bounded": inverter.bounded,
        "dtype": str(inverter.dtype).removeprefix("torch."),
    }


def _text(limit: float) -> float | str:
    """JSON knows no infinity."""
    return limit if abs(limit) < float("inf") else str(limit)


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot read the inverter's metadata: {error.strerror}") from error
    except ValueError as error:
        raise DataError(f"{path}: is not JSON; the inverter's metadata are damaged") from error
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        raise DataError(f"{path}: is no inverter of this version of ikgrad (wanted: format '{FORMAT}')")
    family = config.get("family", _CLASSIC)
    if family not in _FAMILIES:
        raise DataError(f"{path}: unknown family '{family}' of inverters (known: {', '.join(_FAMILIES)})")
    wanted = _FAMILIES[family][1]
    for part, keys in ((config, _KEYS), (config.get("robot"), _ROBOT_KEYS), (config.get("network"), wanted)):
        missing = keys if not isinstance(part, Mapping) else [key for key in keys if key not in part]
        if missing:
            raise DataError(f"{path}: the metadata lack {', '.join(missing)}; the weights cannot be trusted without")
    return config


def _builtin_robot(path: Path, stored: Mapping[str, Any]) -> Robot:
    try:
        return load_robot(stored["name"], base=stored["base"], tip=stored["tip"])
    except (UnknownNameError, RobotError) as error:
        raise RobotError(
            f"{path}: made for robot '{stored['name']}', {stored['base']} to {stored['tip']}, which is not built in; "
            "give it: load_inverter(path, robot=...)"
        ) from error


def _compare(path: Path, stored: Mapping[str, Any], robot: Robot) -> None:
    if stored["fingerprint"] == robot.fingerprint:
        return
    what = "; ".join(_differences(stored, _describe_robot(robot))) or "the geometry of the links"
    raise RobotError(
        f"{path}: these weights are for robot '{stored['name']}' with fingerprint {stored['fingerprint']}, not for "
        f"'{robot.name}' with {robot.fingerprint}; what differs: {what}"
    )


def _differences(stored: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """In words, one after the other; of lists as long as each other what differs alone."""
    for name in ("joint_names", "base", "tip"):
        if stored[name] != now[name]:
            yield f"{name.replace('_', ' ')} {stored[name]}, now {now[name]}"
    if stored["joint_names"] == now["joint_names"]:
        limits = (zip(part["q_min"], part["q_max"], strict=True) for part in (stored, now))
        for name, before, after in zip(now["joint_names"], *limits, strict=True):
            if before != after:
                yield f"limits of {name} {list(before)}, now {list(after)}"
    before, after = stored.get("geometry", []), now["geometry"]
    if len(before) == len(after) and stored["joint_names"] == now["joint_names"]:
        yield from (f"geometry of {a}, now {b}" for a, b in zip(before, after, strict=True) if a != b)


def _read_weights(path: Path, checksum: str) -> dict[str, torch.Tensor]:
    from safetensors import SafetensorError
    from safetensors.torch import load

    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot read the weights: {error.strerror}") from error
    found = hashlib.sha256(content).hexdigest()
    if found != checksum:
        raise DataError(
            f"{path}: the weights are truncated or were changed since they were saved: {len(content)} bytes with "
            f"checksum {found[:16]}, not {str(checksum)[:16]}"
        )
    try:
        return load(content)
    except SafetensorError as error:  # a right checksum over something else
        raise DataError(f"{path}: is not a safetensors file: {error}") from error


def _refuse_folder(folder: Path, force: bool) -> None:
    if not folder.absolute().parent.is_dir():
        raise DataError(f"{folder}: the folder '{folder.parent}' does not exist; create it first")
    if not folder.exists():
        return
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / CONFIG).is_file()):
        raise DataError(f"{folder}: exists and holds no inverter; choose another name")
    if not force:
        raise DataError(f"{folder}: exists already; it is replaced with force=True only")


@contextlib.contextmanager
def _in_one_move(folder: Path) -> Iterator[Path]:
    """A temporary folder that takes the place of ``folder`` when the block ends well."""
    temporary = folder.absolute().parent / f".{folder.name}.{os.getpid()}.tmp"
    old = temporary.with_suffix(".old")
    temporary.mkdir()
    try:
        yield temporary
        if folder.exists():
            os.replace(folder, old)
        try:
            os.replace(temporary, folder)
        except OSError:
            if old.exists():
                os.replace(old, folder)
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


__all__ = ["load_inverter", "save_inverter"]
