"""``ikgrad reproduce puma``: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ikgrad.cli.main import main
from ikgrad.papers.store import load_study

QUICK = ["reproduce", "puma", "--epochs", "60", "--seeds", "2"]
NAMES = {"puma_learning.png", "puma_errors.png", "puma_path.png", "puma.json", "puma_study.npz"}


def test_json_is_one_document(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["config"]["seeds"] == 2
    assert [case["rule"]["name"] for case in document["cases"][:5]] == ["OBP", "OBPR", "BBP", "DBD", "QP"]


def test_tables_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main([*QUICK, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for part in ("Table 1", "Table 2", "Table 6", "Table 8", "Ranking", "Misprints", "py 686.19->686.99"):
        assert part in text
    assert {path.name for path in out.iterdir()} == NAMES
    assert load_study(out / "puma_study.npz").to_json() == json.loads((out / "puma.json").read_text())
    assert main([*QUICK, "--out", str(out)]) == 2
    assert "exists already; it is overwritten with --force only" in capsys.readouterr().err
    assert main([*QUICK, "--out", str(out), "--force"]) == 0
    assert {path.name for path in out.iterdir()} == NAMES


def test_one_rule_by_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "mine.yaml"
    path.write_text("name: wide\nrule: quickprop\norder: batch\nhidden: [20]\n")
    assert main([*QUICK, "--config", str(path)]) == 0
    text = capsys.readouterr().out
    assert "wide" in text
    assert "3-20-6 logistic" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--full"], "--full means --epochs 1000000; give one of the two"),
        (["--resume"], "--resume needs --out DIR"),
        (["--seeds", "0"], "at least 1"),
        (["--config", "{tmp}/missing.yaml"], "cannot read the configuration"),
        (["--config", "{tmp}/rule.yaml"], "rule.yaml: unknown key 'momentun'; did you mean 'momentum'?"),
        (["--config", "{tmp}/qp.yaml"], "qp.yaml: momentum does not exist in quickprop, got 0.5"),
        (["--config", "{tmp}/twice.yaml", "--config", "{tmp}/twice.yaml"], "name must differ between the rules"),
        (["--out", "{tmp}/no/where"], "does not exist; create it first"),
    ],
)
def test_mistakes_get_one_line(options, message, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "rule.yaml").write_text("momentun: 0.5\n")
    (tmp_path / "qp.yaml").write_text("rule: quickprop\nmomentum: 0.5\n")
    (tmp_path / "twice.yaml").write_text("name: twice\n")
    assert main([*QUICK, *(option.format(tmp=tmp_path) for option in options)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.strip().splitlines()) == 1
