"""Without an optional package, every feature that needs it says in one line how to get it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from support import block, mistake

from ikgrad import extras
from ikgrad.bench.peers import PEERS
from ikgrad.cli.main import main
from ikgrad.errors import IkgradError, MissingExtraError

ROOT = Path(__file__).parents[1]
OPTIONAL = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
SAMPLE = ["sample", "--robot", "panda", "--count", "3", "--seed", "0"]
FOLDERS = ["solve", "--robot", "panda", "poses", "-o", "joints"]
TRAIN = ["train", "--robot", "panda", "--tensorboard", "true", "--steps", "2"]

# Package that is not there, the command that needs it, the end of its one line.
CASES = [
    ("pyarrow", [*SAMPLE, "-o", "new.parquet"], "new.parquet: Parquet files need pyarrow; pip install 'ikgrad[data]'"),
    ("pyarrow", ["solve", "--robot", "panda", "there.parquet", "-o", "j.csv"], "Parquet files need pyarrow"),
    ("pyarrow", ["solve", "--robot", "panda", "poses.csv", "-o", "new.parquet"], "Parquet files need pyarrow"),
    ("pyarrow", ["fk", "--robot", "panda", "there.parquet", "-o", "p.csv"], "Parquet files need pyarrow"),
    ("pyarrow", ["plot", "there.parquet"], "there.parquet: Parquet files need pyarrow; pip install 'ikgrad[data]'"),
    ("onnx", ["export", "panda", "panda.onnx"], "ONNX files need onnx; pip install 'ikgrad[export]'"),
    ("onnxscript", ["export", "panda", "panda.onnx"], "ONNX files need onnxscript; pip install 'ikgrad[export]'"),
    ("tensorboard", [*TRAIN, "--model", "unrolled"], "events need tensorboard; pip install 'ikgrad[train]'"),
    ("tensorboard", ["train", "--config", "denso_feedback", "--tensorboard", "true"], "pip install 'ikgrad[train]'"),
    ("ray", [*FOLDERS, "--engine", "ray"], "Ray clusters need ray; pip install 'ikgrad[distributed]'"),
    ("viser", ["view", "--robot", "panda"], "pages of `ikgrad view` need viser; pip install 'ikgrad[viz]'"),
    ("viser", ["view", "--robot", "panda", "--export", "page.html"], "need viser; pip install 'ikgrad[viz]'"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.parquet").write_bytes(b"PAR1")
    assert main([*SAMPLE, "-o", "poses.csv"]) == 0
    (tmp_path / "poses").mkdir()
    assert main([*SAMPLE, "-o", "poses/part.parquet"]) == 0
    return tmp_path


@pytest.mark.parametrize(("package", "command", "line"), CASES, ids=lambda value: str(value)[:24])
def test_a_command_names_the_extra_that_it_lacks(package, command, line, folder, monkeypatch, capsys):
    capsys.readouterr()
    before = {path.name for path in folder.iterdir()}
    block(monkeypatch, package)
    said = mistake(capsys, *command)
    assert line in said
    extra = re.search(r"pip install 'ikgrad\[(\w+)\]'\n$", said)
    assert extra is not None
    assert any(need.lower().startswith(package) for need in OPTIONAL[extra[1]])
    assert {path.name for path in folder.iterdir()} <= before | {"runs"}


def test_every_peer_that_is_not_there_is_named_with_the_extra(monkeypatch, capsys):
    others = [peer for peer in PEERS if peer.package != "pytorch-kinematics"]
    for peer in others:
        block(monkeypatch, peer.module)
    names = [peer.name for peer in others if "ik" in peer.jobs]
    command = ["bench", "ik", "--robot", "panda", "--rows", "10", "--rounds", "1", "--seconds", "0.1", "--peers"]
    assert main([*command, *names]) == 0
    said = capsys.readouterr().out
    for name in names:
        assert f"{name}: not installed; pip install 'ikgrad[bench]'" in said


def test_every_extra_for_features_has_a_case():
    told = set(OPTIONAL) - {"dev", "docs", "browser", "notebook"}  # the first three are for us; tests/test_sliders.py
    covered = {name for name, needs in OPTIONAL.items() for case in CASES if case[0] in " ".join(needs)} | {"bench"}
    assert told <= covered


def test_a_dependency_of_an_extra_that_is_missing_is_named_itself(monkeypatch, tmp_path):
    (tmp_path / "half_installed.py").write_text("import no_such_package.part\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtraError, match=r"pages need no_such_package; pip install 'ikgrad\[viz\]'") as caught:
        extras.need("half_installed", extra="viz", what="pages")
    assert isinstance(caught.value, IkgradError)
    assert isinstance(caught.value, ImportError)
    assert (caught.value.name, caught.value.extra) == ("no_such_package", "viz")


def test_what_is_there_is_imported_and_passes():
    assert extras.need("json.decoder", extra="data", what="files").__name__ == "json.decoder"
    extras.check("json", extra="data", what="files")


def test_no_text_about_an_extra_is_written_by_hand():
    """One function writes it; `ikgrad doctor` lists all, and `ikgrad bench` goes on without a peer."""
    allowed = {"errors.py", "doctor.py", "bench.py", "base.py", "export.py"}
    for path in (ROOT / "src").rglob("*.py"):
        assert path.name in allowed or "pip install 'ikgrad[" not in path.read_text(), path
