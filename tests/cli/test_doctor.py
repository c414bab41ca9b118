"""``ikgrad doctor``: a healthy machine, and every way of being ill."""

from __future__ import annotations

import importlib.metadata
import json
from typing import Any

import pytest

from ikgrad.cli import checkup
from ikgrad.cli.main import main


def doctor(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    status = main(["doctor", *options])
    out, err = capsys.readouterr()
    assert err == ""
    return status, out


def ill(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What is said to be broken; the table and the document agree, and the exit status is 1."""
    status, out = doctor(capsys, "--json")
    report = json.loads(out)
    assert (status, report["ok"]) == (1, False)
    status, out = doctor(capsys)
    assert status == 1
    assert [line[8:] for line in out.splitlines() if line.startswith("broken: ")] == report["problems"]
    assert "Everything" not in out
    return report["problems"]


def wanting(monkeypatch: pytest.MonkeyPatch, *needs: str) -> None:
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: list(needs))


@pytest.fixture
def no_solve(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A solve that went well, to be spoilt."""
    found = dict(robot="panda", poses=100, solved=100, mean_steps=4.71, position_error_m=7e-7, rotation_error_rad=8e-7)
    found |= dict(first_seconds=0.3, seconds=0.0004)
    monkeypatch.setattr(checkup, "solve", lambda: found)
    return found


def test_a_healthy_machine(capsys, monkeypatch):
    wanting(monkeypatch, "torch<2.14,>=2.13", "numpy>=1.26", "no-such-package>=1; extra == 'train'")
    status, out = doctor(capsys)
    assert status == 0
    assert "100 of 100 poses of panda, 4." in out
    assert "[train] lacks no-such-package: pip install 'ikgrad[train]'" in out
    assert out.endswith("Everything that is needed works.\n")
    status, out = doctor(capsys, "--json")
    report = json.loads(out)
    assert (status, report["ok"], report["problems"]) == (0, True, [])
    assert report["solve"]["solved"] == 100
    assert 0 < report["solve"]["position_error_m"] < 1e-6
    assert report["packages"]["torch"]["version"].startswith("2.13")
    assert report["extras"] == {"train": ["no-such-package"]}
    assert report["kernel_cache"]["kernels"] > 0
    assert report["threads"]["torch"] == 1


def test_the_package_asks_for_what_it_uses():
    found = {package.name: package for package in checkup.packages()}
    assert found["torch"].good
    assert found["torch"].extra is None
    assert found["onnx"].extra in {"export", "dev"}
    assert "dev" not in checkup.missing_extras(list(found.values()))


def test_packages_that_are_missing_or_of_another_version(capsys, monkeypatch, no_solve):
    wanting(monkeypatch, "numpy<1.0", "no-such-package>=3", "other; sys_platform == 'nowhere'")
    old, missing = ill(capsys)
    assert old.startswith("numpy ")
    assert old.endswith(", needs <1.0; pip install 'numpy<1.0'")
    assert missing == "no-such-package is missing; needs >=3; pip install 'no-such-package>=3'"


def test_a_bare_checkout_says_how_to_install(capsys, monkeypatch, no_solve):
    def absent(name: str) -> list[str]:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", absent)
    assert ill(capsys) == ["ikgrad is not installed as a package; pip install . in its folder does that"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"solved": 99}, "only 99 of 100 poses of panda were solved"),
        ({"mean_steps": 60.0}, "60.00 steps a pose on panda, expected 4 to 6"),
        ({"rotation_error_rad": 0.1}, "compiled kernels and torch disagree: an answer is off by 7e-07 m, 0.1 rad"),
        ({"position_error_m": float("nan")}, "compiled kernels and torch disagree: an answer is off by nan m"),
    ],
)
def test_a_solve_that_is_not_as_elsewhere(capsys, no_solve, change, said):
    no_solve.update(change)
    (problem,) = ill(capsys)
    assert problem.startswith(said)


@pytest.mark.parametrize("what", ["solve", "threads", "gpu", "kernel_cache"])
def test_what_cannot_even_be_looked_at_is_a_problem_and_no_crash(capsys, monkeypatch, no_solve, what):
    def broken() -> None:
        raise ImportError("libfoo.so: cannot open\nshared object file")

    monkeypatch.setattr(checkup, what, broken)
    (problem,) = ill(capsys)
    assert problem.endswith(": ImportError: libfoo.so: cannot open shared object file")


def test_a_cold_cache_one_that_cannot_be_written_and_old_ones(capsys, monkeypatch, no_solve, tmp_path):
    mine = tmp_path / "ikgrad" / "now"
    mine.mkdir(parents=True)
    monkeypatch.setattr("ikgrad.engine.cache.cache_folder", lambda: mine)
    assert f"{mine}: cold" in doctor(capsys)[1]
    (mine / "a.nbc").write_bytes(bytes(3_000_000))
    old = mine.parent / "before"
    old.mkdir()
    (old / "a.nbc").write_bytes(bytes(2_000_000))
    out = doctor(capsys)[1]
    assert "warm, kernels: 1, 3.0 MB" in out
    assert "folders of other versions beside it: 1, 2.0 MB" in out
    monkeypatch.setattr("ikgrad.engine.cache.cache_folder", lambda: None)
    assert "set NUMBA_CACHE_DIR" in doctor(capsys)[1]


def test_gpus_are_named(capsys, monkeypatch, no_solve):
    found = {"torch": "2.13.0+cu128", "cuda": "12.8", "devices": ["Some GPU"]}
    monkeypatch.setattr(checkup, "gpu", lambda: found)
    assert "Some GPU (CUDA 12.8)" in doctor(capsys)[1]
    found["devices"] = []
    assert "none; torch 2.13.0+cu128 is built for CUDA 12.8" in doctor(capsys)[1]
