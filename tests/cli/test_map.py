"""``ikgrad map``: a table of cells, stopped and gone on with."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from support import Killed, mistake

import ikgrad as ik
from ikgrad.cli import map as command
from ikgrad.cli.main import build_parser, main
from ikgrad.workspace import Survey, even_rotations
from ikgrad.workspace.survey import STARTS

SMALL = ("--robot", "ur5e", "--cell", "0.3", "--orientations", "4")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, the current one, and no progress lines where a busy machine takes its time."""
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def printed(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["map", *argv]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def test_the_table_has_the_map(capsys: pytest.CaptureFixture[str]):
    text = printed(capsys, *SMALL, "--solutions", "3", "--plot", "map.png")
    assert "146 of 0.3 m, 4 orientations" in text
    assert "different solutions" in text
    wanted = ik.reachability(ik.load_robot("ur5e"), cell=0.3, orientations=4, solutions=3).columns()
    found = pq.read_table("ur5e_map.parquet").to_pydict()
    assert list(found) == list(wanted)
    for name, column in wanted.items():
        assert np.array_equal(found[name], column, equal_nan=True), name
    assert Path("map.png").stat().st_size > 10_000


def test_json_and_every_kind_of_file(capsys: pytest.CaptureFixture[str]):
    for name in ("a.csv", "a.npz"):
        summary = json.loads(printed(capsys, *SMALL, "-o", name, "--json"))
    assert summary["poses"] == 4 * 146 > summary["reached"] > summary["unreachable"] > 0
    assert summary["most_solutions"] is None
    with np.load("a.npz") as archive:
        assert np.allclose(archive["orientations"], even_rotations(4))
        share = archive["share"]
    with open("a.csv", newline="") as file:
        assert [float(row["share"]) for row in csv.DictReader(file)] == share.tolist()
    assert summary["reached"] == round(4 * share.sum())


def test_positions_alone_for_an_arm_with_four_joints(capsys: pytest.CaptureFixture[str]):
    text = printed(capsys, "--robot", "arm4", "--cell", "5", "--mask", "1,1,1,0,0,0", "-o", "m.csv")
    assert "1 orientations" in text


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("--robot", "arm4"), "robot 'arm4' has 4 joints, too few for poses with 6 directions; give a mask with fewer"),
        (("--robot", "panda", "--solutions", "4"), "endlessly many solutions of a pose; leave solutions out"),
        (("--robot", "panda", "--cell", "0.001"), "fit in memory, from 0.0051 m on"),
        ((*SMALL, "-o", "m.txt"), "m.txt: unknown kind of file '.txt' (known: .parquet, .csv, .npz)"),
        ((*SMALL, "-o", "m.png", "--plot", "m.png"), "m.png: unknown kind of file '.png'"),
        ((*SMALL, "-o", "old.csv"), "old.csv: exists already; it is overwritten with --force only"),
    ],
)
def test_mistakes_are_one_line(capsys: pytest.CaptureFixture[str], argv: tuple[str, ...], message: str):
    Path("old.csv").write_text("precious")
    assert message in mistake(capsys, "map", *argv)
    assert [path.name for path in Path().iterdir()] == ["old.csv"]


def stopped_after(steps: int, monkeypatch: pytest.MonkeyPatch, stop: Any) -> None:
    """Stop in the middle of a step."""
    real, count = Survey.step, iter(range(steps))

    def step(self: Survey) -> None:
        if next(count, None) is None:
            stop()
        real(self)

    monkeypatch.setattr(Survey, "step", step)


def test_ctrl_c_ends_the_orientation_and_resume_gives_the_same_bytes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    printed(capsys, *SMALL, "-o", "whole.parquet")
    with monkeypatch.context() as patch:
        stopped_after(1, patch, lambda: signal.raise_signal(signal.SIGINT))
        assert main(["map", *SMALL, "-o", "m.parquet"]) == 130
    assert capsys.readouterr() == (
        "",
        "ikgrad: interrupted; finished parts are kept in m.parquet.partial, the same command with --resume goes on "
        "from there\n",
    )
    assert "--resume goes on with it, --force starts anew" in mistake(capsys, "map", *SMALL, "-o", "m.parquet")
    assert "starts was 16, is 3" in mistake(capsys, "map", *SMALL, "-o", "m.parquet", "--resume", "--starts", "3")
    with monkeypatch.context() as patch:
        stopped_after(2, patch, lambda: pytest.fail("two of the four orientations were done"))
        printed(capsys, *SMALL, "-o", "m.parquet", "--resume")
    assert Path("m.parquet").read_bytes() == Path("whole.parquet").read_bytes()
    assert not Path("m.parquet.partial").exists()


def test_a_killed_run_goes_on_from_what_it_kept(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    def kill() -> None:
        raise Killed

    printed(capsys, *SMALL, "-o", "whole.csv")
    with monkeypatch.context() as patch:
        patch.setattr(command, "KEEP_EVERY", 0.0)
        stopped_after(3, patch, kill)
        with pytest.raises(Killed):
            main(["map", *SMALL, "-o", "m.csv"])
    stopped_after(1, monkeypatch, lambda: pytest.fail("three of the four orientations were kept"))
    printed(capsys, *SMALL, "-o", "m.csv", "--resume")
    assert Path("m.csv").read_text() == Path("whole.csv").read_text()


def test_a_full_disk_says_so(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    def full() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(command, "KEEP_EVERY", 0.0)
    stopped_after(1, monkeypatch, full)
    line = mistake(capsys, "map", *SMALL, "-o", "m.csv")
    assert "No space left on device; finished parts are kept in m.csv.partial" in line


def test_defaults_are_those_of_the_function():
    args = build_parser().parse_args(["map", "--robot", "ur5e"])
    survey = Survey(ik.load_robot("ur5e"), cell=0.5)
    assert args.starts == survey.search.starts == STARTS
    assert args.orientations == len(survey.rotations)
    assert (args.cell, args.tol_pos, args.tol_rot) == (0.02, survey.search.tol_pos, survey.search.tol_rot)
    assert torch.equal(survey.rotations, Survey(ik.load_robot("ur5e"), cell=0.5, orientations=50).rotations)
