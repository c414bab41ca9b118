"""``ikgrad plot``: the right figure for every family, told by content; mistakes in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from figure_cases import cells, records
from PIL import Image
from support import mistake

import ikgrad as ik
from ikgrad import plots
from ikgrad.cli import plot
from ikgrad.cli.main import main
from ikgrad.errors import DataError
from ikgrad.files.peek import peek
from ikgrad.files.results import read_results
from ikgrad.plots.families import FAMILIES, recognise, studies
from ikgrad.plots.families.runs import _grouped, read_run


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One input of every family."""
    folder = tmp_path_factory.mktemp("plot")
    sample = ["sample", "--robot", "panda", "--count", "300", "--seed", "0", "-o", str(folder / "poses.csv")]
    assert main(sample) == 0
    for name in ("joints.csv", "joints.npz"):
        assert main(["solve", "--robot", "panda", str(folder / "poses.csv"), "-o", str(folder / name)]) == 0
    shutil.copy(folder / "joints.csv", folder / "results.dat")
    robot = ik.load_robot("panda")
    q = ik.sample_configurations(robot, 50, seed=0)
    np.save(folder / "matrices.npy", ik.forward_kinematics(robot, q).numpy())
    np.save(folder / "q.npy", q.numpy())
    np.savez(folder / "matrices.npz", poses=ik.forward_kinematics(robot, q).numpy())
    (folder / "evaluation.json").write_text(json.dumps({"evaluations": records()}))
    report = {"schema": 1, "job": "ik", "title": "two robots", "cells": cells()}
    (folder / "bench.json").write_text(json.dumps(report))
    for seed in (0, 1):
        run(folder / f"run{seed}", seed=seed)
    run(folder / "slow", seed=0, lr=0.1)
    run(folder / "classic", seed=0, model="classic", head="epoch,member,train,validation", rows="1,0,1.0,\n5,0,.1,.2")
    quick = tmp_path_factory.mktemp("apps")
    (quick / "quick.yaml").write_text("learning_rates: [0.1]\nlearning_rate_max_steps: 618\nrandom_starts: 0\n")
    assert main(["reproduce", "apps", "--config", str(quick / "quick.yaml"), "--out", str(folder / "out")]) == 0
    return folder


STREAM = "step,member,seconds,loss,position_median_mm,position_95_mm,rotation_median_deg,rotation_95_deg"


def run(folder: Path, *, head: str = STREAM, rows: str = "", **settings: Any) -> None:
    """A training run as `ikgrad train` leaves it, for what a figure needs."""
    folder.mkdir()
    values = {"robot": "panda", "model": "unrolled", "lr": 0.01} | settings
    (folder / "config.yaml").write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    (folder / "run.json").write_text(json.dumps({"format": "ikgrad run 1", "state": "finished", "manifest": {}}))
    lines = [f"{step},0,1.0,0.1,{9 / step},{90 / step},{1 / step},{5 / step}" for step in range(1, 50, 4 - 3 % 2)]
    (folder / "history.csv").write_text(head + "\n" + (rows or "\n".join(lines)) + "\n")


# Input, the word for its family, the figures that it offers.
OFFERED = [
    ("joints.csv", "a joint file", "summary workspace joints arm"),
    ("joints.npz", "a joint file", "summary workspace joints arm"),
    ("results.dat", "a joint file", "summary workspace joints arm"),
    ("q.npy", "a joint file", "joints arm"),
    ("poses.csv", "a pose file", "places frames"),
    ("matrices.npy", "a pose file", "places frames"),
    ("matrices.npz", "a pose file", "places frames"),
    ("run0", "a training run", "learning"),
    ("classic", "a training run", "learning"),
    ("out", "a study of `ikgrad reproduce`", "convergence path learning_rate iterations"),
    ("out/apps.json", "a study of `ikgrad reproduce`", "convergence path learning_rate iterations"),
    ("out/apps_study.npz", "a study of `ikgrad reproduce`", "convergence path learning_rate iterations"),
    ("evaluation.json", "an evaluation of `ikgrad evaluate`", "methods speed"),
    ("bench.json", "a benchmark of `ikgrad bench`", "times"),
    ("urdf/ur5e.urdf", "a robot", "arm"),
]


def path_of(made: Path, name: str) -> str:
    return str(Path(__file__).parents[2] / name if name.startswith("urdf/") else made / name)


@pytest.mark.parametrize(("name", "family", "kinds"), OFFERED)
def test_inputs_are_known_by_their_content(name: str, family: str, kinds: str, made: Path):
    found = recognise([path_of(made, name)])
    assert found.family.what == family
    assert list(found.figures) == kinds.split()


EVERY = [(name, kind) for name, _, kinds in OFFERED for kind in kinds.split() if name not in ("out", "out/apps.json")]


@pytest.mark.parametrize(("name", "kind"), EVERY)
def test_every_figure_is_drawn(name: str, kind: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    figure = tmp_path / "figure.png"
    robot = [] if name in ("out", "urdf/ur5e.urdf") else ["--robot", "panda"]
    words = ["plot", path_of(made, name), "--kind", kind, "-o", str(figure), "--dpi", "50", *robot, "--json"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["kind"], printed["output"]) == (kind, str(figure))
    assert kind in printed["kinds"]
    with Image.open(figure) as image:
        shades = np.asarray(image.convert("L"))
    assert 0.002 < (shades < 200).mean() < 0.7


def test_the_default_is_written_here_under_a_telling_name(made: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words, figure in ((["panda"], "panda_arm.png"), ([str(made / "run0")], "run0_learning.png")):
        assert main(["plot", *words, "--dpi", "40"]) == 0
        assert capsys.readouterr().out.startswith(f"a {'robot, arm' if 'panda' in figure else 'training run'}")
        assert (tmp_path / figure).exists()
    assert "exists already; it is overwritten with --force only" in mistake(capsys, "plot", "panda")
    assert main(["plot", "panda", "--force", "-o", "arm.svg"]) == 0
    assert (tmp_path / "arm.svg").read_text().startswith("<?xml")


def test_joints_of_a_robot_turn_it(tmp_path: Path):
    drawn = recognise(["arm4"])
    robot = ik.load_robot("arm4")
    from ikgrad.plots.families import Options

    straight, bent = (drawn.draw(options=Options(robot, q)) for q in (torch.zeros(4), torch.full((4,), 0.5)))
    assert straight.axes[0].get_zlim() != bent.axes[0].get_zlim()


def test_with_the_robot_the_summary_shows_the_workspace(made: Path):
    from ikgrad.plots.families import Options

    found = recognise([made / "joints.csv"])
    assert len(found.draw().axes) == 4
    assert len(found.draw(options=Options(ik.load_robot("panda"))).axes) == 8  # two panels, two colour bars


def test_a_file_in_which_nothing_could_be_solved_is_drawn(tmp_path: Path):
    from ikgrad.plots.families import Options

    (tmp_path / "bad.csv").write_text("x_m,y_m,z_m,qw,qx,qy,qz\nnan,0,1,1,0,0,0\n")
    joints = tmp_path / "joints.csv"
    assert main(["solve", "--robot", "panda", str(tmp_path / "bad.csv"), "-o", str(joints)]) == 0
    figure = recognise([joints]).draw(options=Options(ik.load_robot("panda")))
    assert [text.get_text() for text in figure.axes[0].texts] == ["no row is finite"]


def test_the_summary_is_of_the_rows_in_the_file(made: Path):
    results = [read_results(made / f"joints{kind}", kind) for kind in (".csv", ".npz")]
    for name, values in results[0].items():
        np.testing.assert_array_equal(values, results[1][name])
    assert len(results[0]["steps"]) == 300
    axes = recognise([made / "joints.csv"]).draw().axes
    assert sum(patch.get_height() for patch in axes[2].patches) == 300
    assert axes[0].get_title(loc="right").count("/") == 2  # three percentiles


def test_runs_that_differ_by_the_seed_are_one_curve_with_its_range(made: Path):
    looks = [peek(made / name) for name in ("run0", "run1", "slow")]
    groups = _grouped([read_run(look) for look in looks])
    assert {name: [run.name for run in runs] for name, runs in groups.items()} == {
        "lr 0.01": ["run0", "run1"],
        "lr 0.1": ["slow"],
    }
    figure = recognise([made / name for name in ("run0", "run1", "slow")]).draw()
    assert len(figure.axes[0].collections) == 2  # one band a quantity, of the group with two runs
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["lr 0.01", "lr 0.1"]


MISTAKES: list[tuple[list[str], str]] = [
    (["nowhere"], "nowhere: no such file or folder"),
    (["text.txt"], "text.txt: nothing to draw; known are a joint file, a pose file, a map, a training run, a study"),
    (["broken.json"], "broken.json: is no JSON document"),
    (["other.json"], "other.json: nothing to draw"),
    (["broken.npy"], "broken.npy: is not a readable .npy file"),
    (["empty"], "empty: nothing to draw"),
    (["{made}/poses.csv", "--kind", "places2"], "unknown kind of figure 'places2'; did you mean 'places'?"),
    (["{made}/poses.csv", "{made}/joints.csv"], "is a pose file; those are drawn one at a time, got 2"),
    (["{made}/run0", "{made}/poses.csv"], "poses.csv: is no training run; several inputs must all be training runs"),
    (["{made}/run0", "{made}/classic"], "runs of the model classic and of the others have different curves"),
    (["{made}/joints.csv", "--kind", "arm"], "a figure of the arm needs the robot: --robot NAME or URDF file"),
    (["{made}/joints.csv", "--robot", "ur5e", "--kind", "arm"], "unknown column 'panda_joint1'"),
    (["{made}/poses.csv", "--tip", "x"], "--base and --tip need --robot"),
    (["{made}/poses.csv", "--q", "1,2"], "--q turns the joints of a robot that is drawn; give a robot"),
    (["panda", "--q", "1,2"], "q must have shape"),
    (["panda", "-o", "arm.pdf"], "arm.pdf: unknown kind of file '.pdf' (known: .png, .svg)"),
    (["panda", "-o", "no/arm.png"], "no/arm.png: the folder 'no' does not exist; create it first"),
    (["apps.json"], "apps_study.npz: is missing and holds the curves; `ikgrad reproduce apps --out DIR` writes it"),
    (["two"], "two: holds several studies; name one of two/apps_study.npz, two/puma_study.npz"),
    (["apps_study.npz"], "apps_study.npz: is no study of this version of ikgrad; reproduce it anew"),
    (["half.json"], "half.json: is no evaluation of this version of ikgrad"),
    (["unmeasured.json"], "no solver was measured, so there is nothing to draw"),
    (["short.csv"], "short.csv: is damaged"),
    (["bad.csv"], "bad.csv: no pose is finite, so there is nothing to draw"),
]


@pytest.mark.parametrize(("words", "line"), MISTAKES, ids=lambda value: value[0] if isinstance(value, list) else "")
def test_mistakes_get_one_line_and_write_nothing(words, line, made: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.txt").write_text("Dear reader\n")
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "other.json").write_text('{"a": 1}')
    (tmp_path / "broken.npy").write_bytes(b"\x93NUMPY\x01")
    for name in ("empty", "two"):
        (tmp_path / name).mkdir()
    for name in ("two/apps", "two/puma"):
        np.savez(tmp_path / f"{name}_study.npz", a=1)
    if words[0] == "apps_study.npz":
        np.savez(tmp_path / "apps_study.npz", study=np.array('{"$": "record", "of": "os:system", "fields": {}}'))
    (tmp_path / "apps.json").write_text('{"paper": "apps"}')
    (tmp_path / "half.json").write_text(json.dumps([{"robot": "a", "task": "b", "rows": [{"method": "c"}]}]))
    unmeasured = {"schema": 1, "job": "ik", "title": "t", "cells": [{"missing": "not installed"}]}
    (tmp_path / "unmeasured.json").write_text(json.dumps(unmeasured))
    head = (made / "joints.csv").read_text().splitlines()[0]
    (tmp_path / "short.csv").write_text(f"{head}\n1,2\n")
    (tmp_path / "bad.csv").write_text("x_m,y_m,z_m,qw,qx,qy,qz\nnan,0,1,1,0,0,0\n")
    before = sorted(tmp_path.rglob("*"))
    assert line in mistake(capsys, "plot", *(word.format(made=made) for word in words))
    assert sorted(tmp_path.rglob("*")) == before


def test_the_help_lists_every_figure():
    for _, _, kinds in OFFERED:
        assert all(kind in plot.LINES for kind in kinds.split())
    for family in FAMILIES:
        word = family.what.split(" of ")[0]
        assert word in plot.LINES, word
    for paper, default in studies.DEFAULT.items():
        for name in studies._figures(paper):
            kind = name.removeprefix(f"{paper}_")
            assert kind in plot.LINES or kind.startswith("figure")
        assert f"{paper}: {default}" in plot.LINES


def test_a_map_is_drawn_from_its_table(tmp_path: Path):
    found = ik.reachability(ik.load_robot("ur5e"), cell=0.3, orientations=2)
    found.save(tmp_path / "map.csv")
    known = recognise([tmp_path / "map.csv"])
    assert known.family.what == "a map"
    cells = found.centres.numpy(), found.share.numpy(), found.condition.numpy()
    wanted = plots.workspace_map(*cells, cell=0.3, title=f"map.csv: {len(found.share):,} cells")
    assert plots.to_png(known.draw()) == plots.to_png(wanted)


def test_parquet_is_read_like_csv(made: Path, tmp_path: Path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "joints.parquet"
    assert main(["solve", "--robot", "panda", str(made / "poses.csv"), "-o", str(path)]) == 0
    assert list(recognise([path]).figures) == ["summary", "workspace", "joints", "arm"]
    wanted, found = read_results(made / "joints.csv", ".csv"), read_results(path, ".parquet")
    for name, values in wanted.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("position_error_m,rotation_error_rad,success,reason,steps\n", "has no rows"),
        ("position_error_m,rotation_error_rad,success,reason,steps\n1,2,maybe,x,3\n", "truth value, 'maybe'"),
        ("position_error_m,rotation_error_rad,success,reason,steps\nx,2,True,x,3\n", "is damaged: could not convert"),
        ("position_error_m,rotation_error_rad,success,reason\n1,2,True,x\n", "no column, or no truth value, 'steps'"),
    ],
)
def test_results_that_cannot_be_read(text: str, line: str, tmp_path: Path):
    path = tmp_path / "results.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=line):
        read_results(path, ".csv")
