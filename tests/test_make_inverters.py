"""The script that makes the package's inverters: what it calls, what it stores, what it skips."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path

import pytest
import torch
from PIL import Image

import ikgrad as ik

SCRIPT = Path(__file__).parents[1] / "scripts" / "make_inverters.py"


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The script with a package and an `ikgrad` command of its own, which writes what the real one writes."""
    spec = importlib.util.spec_from_file_location("make_inverters", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "package").mkdir()
    module.calls = []

    def command(name: str, *arguments: str) -> None:
        module.calls.append((name, *arguments))
        if name == "train":
            robot = ik.load_robot(arguments[arguments.index("--robot") + 1])
            run = Path(arguments[arguments.index("--out") + 1])
            run.mkdir(exist_ok=True)
            ik.UnrolledInverter(robot, width=4, depth=1, seed=len(module.calls)).save(run / "model", force=True)
            return
        report = Path(arguments[arguments.index("--out") + 1])
        report.mkdir(exist_ok=True)
        (report / "evaluation.json").write_text("{}")
        Image.new("RGB", (8, 8), "white").save(report / "evaluation.png")

    monkeypatch.setattr(module, "_ikgrad", command)
    monkeypatch.setattr(module, "PACKAGE", tmp_path / "package")
    monkeypatch.chdir(tmp_path)
    return module


def run(script, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> list[str]:
    script.calls.clear()
    monkeypatch.setattr(sys, "argv", ["make_inverters.py", "--robots", "panda", "arm4", *arguments])
    script.main()
    return [" ".join(call) for call in script.calls]


def test_each_is_trained_evaluated_and_stored_with_its_report(script, monkeypatch, tmp_path):
    calls = run(script, monkeypatch, "--minutes", "2")
    assert calls == [
        f"{command} {options}"
        for name in ("panda", "arm4")
        for command, options in (
            ("train", f"--robot {name} --model unrolled --minutes 2.0 --seed 0 --out runs/inverters/{name}"),
            ("evaluate", f"runs/inverters/{name} --out runs/inverters/{name}/report --force"),
        )
    ]
    files = {"config.json", "model.safetensors", "report.json", "report.png"}
    assert {path.name for path in (tmp_path / "package" / "panda").iterdir()} == files
    stored = ik.load_inverter(tmp_path / "package" / "panda").state_dict()
    trained = ik.load_inverter(tmp_path / "runs" / "inverters" / "panda").state_dict()
    assert all(torch.equal(stored[name], trained[name]) for name in trained)


def test_what_is_done_is_skipped_and_what_was_stopped_goes_on(script, monkeypatch, tmp_path):
    run(script, monkeypatch)
    assert run(script, monkeypatch) == []
    (tmp_path / "package" / "panda" / "report.png").unlink()
    assert [call.split()[0] for call in run(script, monkeypatch)] == ["evaluate"]
    shutil.rmtree(tmp_path / "runs" / "inverters" / "arm4" / "model")
    (tmp_path / "package" / "arm4" / "model.safetensors").unlink()
    calls = run(script, monkeypatch)
    assert [call.split()[0] for call in calls] == ["train", "evaluate"]
    assert calls[0].endswith("--out runs/inverters/arm4 --resume")
    assert [call.endswith("--force") for call in run(script, monkeypatch, "--redo")] == [True] * 4
