"""The C++ program of docs/howto/cpp.md: what it asks a file for is there, and compiled it answers as Python does."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

import ikgrad as ik

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/howto/cpp.md").read_text()
HEADERS = Path(os.environ.get("ONNXRUNTIME_HEADERS", "/usr/include/onnxruntime"))


def block(kind: str) -> str:
    found = re.search(rf"^```{kind}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


def names(array: str) -> list[str]:
    """The strings in an array of the program."""
    found = re.search(rf"{array}{{(.*?)}};", block("cpp"))
    assert found is not None
    return re.findall(r'"(\w+)"', found[1])


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> onnxruntime.InferenceSession:
    inverter = ik.Inverter(ik.load_robot("panda"), feedback=True, hidden=(8,), dtype=torch.float32)
    done = ik.export_inverter(inverter, tmp_path_factory.mktemp("cpp") / "panda.onnx", steps=0)
    return onnxruntime.InferenceSession(done.path, providers=["CPUExecutionProvider"])


def rows(count: int) -> np.ndarray:
    """Poses and present joints as the program reads them: (count, 16 + 7)."""
    T, _, q_current = ik.data.TaskStream(ik.load_robot("panda"), batch_size=count, seed=5).batch(0)
    return np.concatenate([T.reshape(count, 16).numpy(), q_current.numpy()], axis=1).astype(np.float32)


def test_the_file_has_the_names_shapes_and_types_that_the_program_asks_for(session):
    inputs, outputs = session.get_inputs(), session.get_outputs()
    assert [node.name for node in inputs] == names("input_names")
    assert [node.name for node in outputs] == names("output_names")
    assert {node.type for node in [*inputs, *outputs]} == {"tensor(float)"}
    assert [node.shape[1:] for node in [*inputs, *outputs]] == [[4, 4], [7], [7], [], []]


@pytest.mark.slow
def test_the_program_answers_as_python_does(session, tmp_path: Path):
    if not (HEADERS / "onnxruntime_cxx_api.h").exists() or shutil.which("cmake") is None:
        pytest.skip(f"needs cmake and the headers of ONNX Runtime in {HEADERS} (or ONNXRUNTIME_HEADERS)")
    (library,) = (Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so.*")
    (tmp_path / "sdk/lib").mkdir(parents=True)
    (tmp_path / "sdk/include").symlink_to(HEADERS)
    for name in ("libonnxruntime.so", "libonnxruntime.so.1"):
        (tmp_path / "sdk/lib" / name).symlink_to(library)
    (tmp_path / "inverter.cpp").write_text(block("cpp"))
    (tmp_path / "CMakeLists.txt").write_text(block("cmake"))
    for command in (
        ["cmake", "-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'sdk'}"],
        ["cmake", "--build", "build"],
    ):
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)

    asked = rows(1000)
    np.savetxt(tmp_path / "poses.txt", asked, fmt="%.9g")
    with (tmp_path / "poses.txt").open() as poses:
        done = subprocess.run(
            [tmp_path / "build/inverter", session._model_path], stdin=poses, capture_output=True, text=True, check=True
        )
    answered = np.loadtxt(done.stdout.splitlines(), dtype=np.float32)
    q, *errors = session.run(None, {"T": asked[:, :16].reshape(-1, 4, 4), "q_current": asked[:, 16:]})
    np.testing.assert_allclose(answered[:, :7], q, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(answered[:, 7:], np.stack(errors, axis=1), rtol=1e-6, atol=1e-12)
