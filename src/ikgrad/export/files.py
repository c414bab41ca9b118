"""Inverters as files for other programs: ONNX and ``torch.export``, with all that a user must know inside."""

from __future__ import annotations

import json
import logging
import platform
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ikgrad import __version__
from ikgrad.data import sample_configurations
from ikgrad.errors import ConfigError, DataError
from ikgrad.export.refined import Refined
from ikgrad.extras import need
from ikgrad.files.places import check_output, in_one_move
from ikgrad.kinematics import forward_kinematics
from ikgrad.networks.storage import AnyInverter

FORMAT = "ikgrad export 1"
SUFFIXES = (".onnx", ".pt2")
METADATA = "ikgrad.json"  # name of the metadata inside a .pt2 file
_ONNX = "ONNX files"
_TRACED = 5  # poses that the graph is drawn with; any number but 1, which exporters take for a constant


class Exported(NamedTuple):
    """What was written."""

    path: Path
    metadata: dict[str, Any]
    difference: float | None  # [rad or m] largest difference of joints between the file and torch; None: not looked


def export_inverter(
    inverter: AnyInverter,
    path: str | Path,
    *,
    steps: int | None = None,
    dtype: torch.dtype | None = None,
    force: bool = False,
) -> Exported:
    """Write an inverter as one file: scaling, kinematics, and if wanted damped steps and the check, inside the graph.

    Inputs are ``T`` (batch, 4, 4), and ``q_current`` (batch, n) for an inverter that looks at the present joints; the
    output ``q`` is (batch, n). With ``steps`` there are also ``position_error`` (batch,) [m] and ``rotation_error``
    (batch,) [rad], measured by forward kinematics. Whatever the dtype of inputs and outputs, the chain is evaluated in
    float64. The file is read back and compared with torch on 1,000 poses before it gets its name, an ONNX file if
    onnxruntime is installed; torch takes the compiled kernels there, the graph does not.

    Args:
        inverter: what to write, of any family.
        path: ``.onnx``, or ``.pt2`` for `torch.export.load`.
        steps: damped steps behind the network, see `Refined`; 0 only measures; None leaves steps and check out.
        dtype: float32 or float64, of inputs and outputs; default: that of an `Inverter`, which takes no other, and
            float32 for the families that hold the chain.
        force: overwrite.

    Returns:
        Path, metadata, and the largest difference.

    Raises:
        ConfigError: ``steps`` is negative, or the inverter does not take the dtype.
        MissingExtraError: packages for ONNX files are missing.
        DataError: the file exists or cannot be written, or what was written computes something else.

    Example:
        >>> import ikgrad as ik, tempfile
        >>> from ikgrad.export import export_inverter, read_metadata
        >>> robot = ik.load_robot("arm4")
        >>> q = ik.sample_configurations(robot, 100, seed=0)
        >>> inverter = ik.Inverter(robot).fit(ik.forward_kinematics(robot, q), q)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     done = export_inverter(inverter, folder + "/arm4.pt2", steps=1)
        ...     read_metadata(done.path)["robot"]["joint_names"], done.difference < 1e-12
        (['joint_1', 'joint_2', 'joint_3', 'joint_4'], True)
    """
    path = check_output(path, SUFFIXES, force=force)
    if steps is not None and steps < 0:
        raise ConfigError(f"steps must not be negative, got {steps}")
    dtype = _interface(inverter, dtype)
    module = (inverter if steps is None else Refined(inverter, steps=steps)).eval()
    metadata = _describe(inverter, steps, dtype)
    with in_one_move(path, force=force) as temporary, torch.no_grad():
        write = _write_onnx if path.suffix == ".onnx" else _write_program
        write(module, _example(inverter, _TRACED, dtype), temporary, metadata)
        difference = _difference(module, _example(inverter, 1000, dtype), temporary)
        if difference is not None and not difference < _allowed(inverter, dtype):
            raise DataError(f"{path}: the exported graph differs from torch by {difference:.2g}; it was not kept")
    return Exported(path, metadata, difference)


def read_metadata(path: str | Path) -> dict[str, Any]:
    """What an exported file says about itself: robot, joints, units, frames, fingerprint, versions.

    Raises:
        DataError: the file cannot be read or was not written by `export_inverter`.
        MissingExtraError: the package for ONNX files is missing.
    """
    path = Path(path)
    try:
        text = _onnx_metadata(path) if path.suffix == ".onnx" else _program_metadata(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error
    if not text:
        raise DataError(f"{path}: has no metadata of ikgrad; it was not written by `ikgrad export`")
    metadata: dict[str, Any] = json.loads(text)
    return metadata


def _interface(inverter: AnyInverter, dtype: torch.dtype | None) -> torch.dtype:
    """Of inputs and outputs."""
    own = getattr(inverter, "dtype", None)
    dtype = dtype or own or torch.float32
    if dtype not in (torch.float32, torch.float64) or (own is not None and dtype != own):
        allowed = "torch.float32 or torch.float64" if own is None else f"{own}, that of the inverter"
        raise ConfigError(f"dtype must be {allowed}, got {dtype}")
    return dtype


def _allowed(inverter: AnyInverter, dtype: torch.dtype) -> float:
    """Largest difference [rad or m] that is rounding: of the inputs and outputs, or of the network."""
    network = next(inverter.parameters()).dtype
    return 1e-4 if torch.float32 in (dtype, network) else 1e-9


def _describe(inverter: AnyInverter, steps: int | None, dtype: torch.dtype) -> dict[str, Any]:
    robot = inverter.robot
    inputs = {"T": f"(batch, 4, 4) pose of {robot.tip} in {robot.base}, row-major homogeneous matrices [m]"}
    if inverter.feedback:
        inputs["q_current"] = f"(batch, {robot.dof}) present joints, in the order of joint_names"
    outputs = {"q": f"(batch, {robot.dof}) joints, in the order of joint_names"}
    if steps is not None:
        outputs |= {"position_error": "(batch,) [m] at q", "rotation_error": "(batch,) [rad] at q"}
    return {
        "format": FORMAT,
        "robot": {
            "name": robot.name,
            "fingerprint": robot.fingerprint,
            "joint_names": list(robot.joint_names),
            "joint_units": ["rad" if turns else "m" for turns in robot.revolute.tolist()],
            "base": robot.base,
            "tip": robot.tip,
        },
        "inputs": inputs,
        "outputs": outputs,
        "quaternions": "none at the interface: rotations are 3 x 3 matrices, columns are the tip's axes in the base",
        "family": getattr(inverter, "family", "classic"),
        "dtype": str(dtype).removeprefix("torch."),
        "network_dtype": str(next(inverter.parameters()).dtype).removeprefix("torch."),
        "chain_dtype": "float64",
        "damped_steps": steps,
        "versions": {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
    }


def _example(inverter: AnyInverter, count: int, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Poses, and for an inverter that looks at the present joints some a little beside."""
    robot = inverter.robot.detach()
    q = sample_configurations(robot, count, seed=0)
    T = forward_kinematics(robot, q).to(dtype)
    return (T, (q + 0.05).to(dtype)) if inverter.feedback else (T,)


def _shapes(arguments: tuple[Tensor, ...]) -> tuple[dict[int, Any], ...]:
    batch = torch.export.Dim("batch")
    return tuple({0: batch} for _ in arguments)


def _write_onnx(module: nn.Module, arguments: tuple[Tensor, ...], path: Path, metadata: dict[str, Any]) -> None:
    need("onnx", extra="export", what=_ONNX)
    optimizer = need("onnxscript.optimizer", extra="export", what=_ONNX)
    names = ["q", "position_error", "rotation_error"] if isinstance(module, Refined) else ["q"]
    with _quiet():
        program = torch.onnx.export(
            module,
            arguments,
            dynamo=True,
            dynamic_shapes=_shapes(arguments),
            input_names=["T", "q_current"][: len(arguments)],
            output_names=names,
            verbose=False,
            optimize=False,  # takes minutes over the chain, and leaves no more than the two passes below
        )
        assert program is not None
        optimizer.fold_constants(program.model)
        optimizer.remove_unused_nodes(program.model)
    for node in program.model.graph:
        node.metadata_props.clear()  # stack traces, with the paths of this machine
    program.model.metadata_props["ikgrad"] = json.dumps(metadata)
    program.save(path)


def _write_program(module: nn.Module, arguments: tuple[Tensor, ...], path: Path, metadata: dict[str, Any]) -> None:
    with _quiet():
        program = torch.export.export(module, arguments, dynamic_shapes=_shapes(arguments))
        torch.export.save(program, path, extra_files={METADATA: json.dumps(metadata)})


@contextmanager
def _quiet() -> Iterator[None]:
    """Torch's own notes about packages that it does not find, and its warnings about itself, are not the user's."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _difference(module: nn.Module, arguments: tuple[Tensor, ...], path: Path) -> float | None:
    """Largest difference of the joints between the file and torch."""
    wanted = module(*arguments)
    wanted = wanted[0] if isinstance(wanted, tuple) else wanted
    if path.suffix == ".pt2":
        with _quiet():
            got = torch.export.load(path).module()(*arguments)
        got = got[0] if isinstance(got, tuple) else got
    else:
        try:
            import onnxruntime
        except ImportError:
            return None
        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        feeds = {node.name: x.numpy() for node, x in zip(session.get_inputs(), arguments, strict=True)}
        got = torch.from_numpy(session.run(["q"], feeds)[0])
    return float((got - wanted).abs().max())


def _onnx_metadata(path: Path) -> str:
    onnx = need("onnx", extra="export", what=_ONNX)
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load(path, load_external_data=False)
    except DecodeError as error:
        raise ValueError("it is no ONNX file") from error
    return {entry.key: entry.value for entry in model.metadata_props}.get("ikgrad", "")


def _program_metadata(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith("/" + METADATA)]
            return archive.read(names[0]).decode() if names else ""
    except zipfile.BadZipFile as error:
        raise ValueError("it is no torch.export file") from error


__all__ = ["Exported", "export_inverter", "read_metadata"]
