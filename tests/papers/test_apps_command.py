"""``ikgrad reproduce apps``: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ikgrad.cli.main import main
from ikgrad.papers.store import load_study

QUICK = "random_starts: 5\nrandom_max_steps: 20\nlearning_rates: [0.1]\nlearning_rate_max_steps: 5\n"


@pytest.fixture
def quick(tmp_path: Path) -> str:
    path = tmp_path / "quick.yaml"
    path.write_text(QUICK)
    return str(path)


def test_json_is_one_document_with_the_papers_iterations(quick: str, capsys: pytest.CaptureFixture[str]):
    assert main(["reproduce", "apps", "--json", "--config", quick, "--starts", "3"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["iterations"] == [438, 256, 316, 618, 278, 233, 281]
    assert document["config"]["random_starts"] == 3
    assert all(check["holds"] for check in document["checks"])


def test_tables_and_files(quick: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main(["reproduce", "apps", "--config", quick, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for part in ("Table 3", "Table 4", "Table 5", "Table 6", "Newton-Raphson", "Misprints", "438", "-20.0995*"):
        assert part in text
    names = {"apps_convergence.png", "apps_path.png", "apps_learning_rate.png", "apps_iterations.png", "apps.json"}
    names |= {"apps_study.npz"}
    assert {path.name for path in out.iterdir()} == names
    assert json.loads((out / "apps.json").read_text())["paper"] == "apps"

    assert json.loads(json.dumps(load_study(out / "apps_study.npz").to_json())) == json.loads(
        (out / "apps.json").read_text()
    )
    before = (out / "apps.json").read_bytes()
    assert main(["reproduce", "apps", "--config", quick, "--out", str(out)]) == 2
    assert "exists already; it is overwritten with --force only" in capsys.readouterr().err
    assert (out / "apps.json").read_bytes() == before
    assert {path.name for path in out.iterdir()} == names
    assert main(["reproduce", "apps", "--config", quick, "--out", str(out), "--force"]) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "{tmp}/no/where"], "does not exist; create it first"),
        (["--out", "{tmp}/quick.yaml"], "quick.yaml: is a file, not a folder"),
        (["--config", "{tmp}/missing.yaml"], "cannot read the configuration"),
        (["--starts", "none"], "expected a whole number"),
        (["--starts", "0"], "at least 1"),
    ],
)
def test_mistakes_get_one_line(
    options: list[str], message: str, quick: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["reproduce", "apps", *(option.format(tmp=tmp_path) for option in options)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_a_folder_that_was_made_for_nothing_is_taken_away(
    quick: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ikgrad.papers.apps.study.run_study", stop)
    assert main(["reproduce", "apps", "--config", quick, "--out", str(tmp_path / "out")]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_unknown_key_names_the_nearest(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "wrong.yaml"
    path.write_text("random_start: 5\n")
    assert main(["reproduce", "apps", "--config", str(path)]) == 2
    assert f"{path}: unknown key 'random_start'; did you mean 'random_starts'?" in capsys.readouterr().err
