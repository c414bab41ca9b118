"""``ikgrad evaluate``: tables, JSON, pages, every kind of inverter, and one line for every mistake."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ikgrad as ik
from ikgrad.cli import evaluate as command
from ikgrad.cli.main import main
from ikgrad.evaluation import PROTOCOLS

FEW = ["--count", "40"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)


@pytest.fixture
def folder() -> str:
    ik.UnrolledInverter(ik.load_robot("panda"), rounds=1, width=8).save("mine")
    return "mine"


def mistake(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["evaluate", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def document(capsys: pytest.CaptureFixture[str], *argv: str) -> dict:
    assert main(["evaluate", *argv, *FEW, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_names_are_those_of_the_protocols():
    assert tuple(PROTOCOLS) == command.NAMES
    assert all(f"\n{name} " in command.DESCRIPTION for name in command.NAMES)


def test_tables_of_every_protocol(folder: str, capsys: pytest.CaptureFixture[str]):
    assert main(["evaluate", folder, *FEW]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for task in ("local, 0.5 rad", "global", "ikflow, 40 poses x 50", "tracik, 1e-5", "path, closed", "line, closed"):
        assert f"ikgrad evaluate: panda, task {task}" in out
    assert "published, not measured here" in out
    assert "inverter + 3 steps" in out
    assert len(re.findall(r"^ plain, in the same time: \d+ steps ", out, re.M)) == 3
    assert "…" not in out  # no column is cut


def test_json_is_one_document(folder: str, capsys: pytest.CaptureFixture[str]):
    found = document(capsys, folder, "--protocols", "path,local", "--seed", "3")
    assert (found["inverter"], found["robot"], found["family"]) == ("mine", "panda", "unrolled")
    assert found["fingerprint"] == ik.load_robot("panda").fingerprint
    assert [e["protocol"] for e in found["evaluations"]] == ["path", "local"]
    local = found["evaluations"][1]
    assert (local["count"], local["seed"], local["threads"]) == (40, 3, 1)
    assert len(local["rows"][0]["errors"]["position_mm"]) == 3
    assert "answers" not in local


def test_every_family_is_served(capsys: pytest.CaptureFixture[str]):
    train = ["train", "--robot", "denso_vp6242", "--model", "classic", "--hidden", "[5]", "--epochs", "2"]
    train += ["--data", "{scheme: joint_box, count: 60, half_width: 0.3}"]
    assert main([*train, "--out", "plain"]) == 0
    assert main([*train, "--feedback", "true", "--out", "feedback"]) == 0
    ik.IncrementInverter(ik.load_robot("denso_vp6242"), width=8).save("increment")
    capsys.readouterr()
    families = {
        "plain": "classic, traditional",
        "feedback": "classic, present joints as inputs",
        "increment": "increment",
    }
    for name, family in families.items():
        found = document(capsys, name, "--protocols", "ikflow,tracik,path")
        assert found["family"] == family
        assert [e["protocol"] for e in found["evaluations"]] == ["ikflow", "tracik", "path"]
        assert found["evaluations"][0]["count"] == (40 if name == "plain" else 2000)


def test_the_best_of_several_starts_is_better(folder: str, capsys: pytest.CaptureFixture[str]):
    one, eight = (document(capsys, folder, "--protocols", "global", "--starts", k) for k in ("1", "8"))
    assert eight["family"] == "best of 8 unrolled"
    medians = [found["evaluations"][0]["rows"][0]["errors"]["rotation_deg"][0] for found in (one, eight)]
    assert medians[0] > 1.2 * medians[1]
    robot = ik.load_robot("denso_vp6242")
    q = ik.sample_configurations(robot, 30, seed=0)
    ik.Inverter(robot).fit(ik.forward_kinematics(robot, q), q).save("classic")
    assert "--starts is for the families increment and unrolled" in mistake(capsys, "classic", *FEW, "--starts", "2")


def test_a_urdf_of_ones_own(zoo_path: Path, capsys: pytest.CaptureFixture[str]):
    robot = ik.load_robot(zoo_path, tip="hand")
    ik.IncrementInverter(robot, width=8).save("zoo")
    found = document(capsys, "zoo", "--robot", str(zoo_path), "--tip", "hand", "--protocols", "local,global")
    assert (found["robot"], found["fingerprint"]) == ("zoo", robot.fingerprint)
    assert "which is not built in; give it" in mistake(capsys, "zoo", *FEW)


def test_a_name_is_looked_up_as_ready_made(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    asked = []

    def ready_made(name, *, robot=None):
        asked.append((name, robot))
        return ik.UnrolledInverter(ik.load_robot("panda"), width=8)

    monkeypatch.setattr("ikgrad.networks.load_inverter", ready_made)
    document(capsys, "panda", "--protocols", "local")
    assert asked == [("panda", None)]


def test_what_an_arm_cannot_do_is_left_out_and_said(capsys: pytest.CaptureFixture[str]):
    ik.UnrolledInverter(ik.load_robot("arm4"), rounds=1, width=8).save("arm4")
    found = document(capsys, "arm4", "--protocols", "local,line")
    assert found["left_out"] == {"line": "robot 'arm4' can follow only 0 of 8 random straight lines, 1 wanted"}
    assert main(["evaluate", "arm4", "--protocols", "local,line", *FEW]) == 0
    assert "line: left out, robot 'arm4' can follow only 0" in capsys.readouterr().out
    assert "robot 'arm4' can follow only 0" in mistake(capsys, "arm4", "--protocols", "line", *FEW)


# ---------------------------------------------------------------- pages


def test_a_folder_gets_all_files(folder: str, capsys: pytest.CaptureFixture[str]):
    printed = document(capsys, folder, "--protocols", "local,tracik", "--out", "report")
    assert sorted(path.name for path in Path("report").iterdir()) == sorted(command.FILES)
    assert json.loads(Path("report/evaluation.json").read_text()) == printed
    page = Path("report/evaluation.html").read_text()
    assert "<h1>panda: unrolled inverter</h1>" in page
    assert "mine, " in page
    assert page.count("<tr>") == 2 + (1 + 11) + (1 + 3)  # summary, local, tracik
    assert "http://" not in page
    assert not re.search(r'(src|href)="(?!data:)', page)
    (encoded,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB"), dtype=float)
    assert 0.01 < (picture.min(axis=-1) < 200).mean() < 0.6
    with Image.open("report/evaluation.png") as written:
        assert written.size[0] > 1000


def test_a_page_of_solve_rates_alone_has_no_picture(folder: str, capsys: pytest.CaptureFixture[str]):
    for name in ("page.html", "page.png"):
        assert main(["evaluate", folder, "--protocols", "tracik", *FEW, "--report", name]) == 0
    assert "wrote page.png" in capsys.readouterr().err
    page = Path("page.html").read_text()
    assert "<img" not in page
    assert "solve_ik solves 100.00 % from its own starts" in page


def test_files_are_kept_unless_forced(folder: str, capsys: pytest.CaptureFixture[str]):
    Path("page.html").write_text("precious")
    argv = [folder, "--protocols", "tracik", *FEW, "--report", "page.html"]
    assert "page.html: exists already; it is overwritten with --force only" in mistake(capsys, *argv)
    assert Path("page.html").read_text() == "precious"
    assert main(["evaluate", *argv, "--force"]) == 0
    assert Path("page.html").read_text().startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--protocols", "lokal"], "unknown protocol 'lokal'; did you mean 'local'? (known: local, global, ikflow,"),
        (["--protocols", ","], "--protocols: expected some of local,global,ikflow,tracik,path,line, got ','"),
        (["--count", "0"], "--count: expected a whole number, at least 1, got '0'"),
        (["--seed", "2147483648"], "seed must be in [0, 2^31), got 2147483648"),
        (["--threads", "0"], "--threads: expected a whole number, at least 1, got '0'"),
        (["--tip", "x"], "--base and --tip need --robot"),
        (["--robot", "ur5e"], "these weights are for robot 'panda' with fingerprint"),
        (["--robot", "pnda"], "unknown robot 'pnda'; did you mean 'panda'?"),
        (["--report", "page.svg"], "page.svg: unknown kind of file '.svg' (known: .png, .html)"),
        (["--report", "none/page.png"], "none/page.png: the folder 'none' does not exist; create it first"),
        (["--out", "none/out"], "none/out: the folder 'none' does not exist; create it first"),
        (["--out", "mine/config.json"], "mine/config.json: is a file, not a folder"),
        (["--out", "new", "--robot", "ur5e"], "what differs: joint names"),
    ],
)
def test_mistakes_are_one_line_and_leave_no_file(options, message, folder: str, tmp_path: Path, capsys):
    before = sorted(tmp_path.iterdir())
    assert message in mistake(capsys, folder, *options)
    assert sorted(tmp_path.iterdir()) == before


def test_folders_without_an_inverter_are_one_line(folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "empty").mkdir()
    assert "empty: holds no trained inverter" in mistake(capsys, "empty")
    (tmp_path / "two/model-0").mkdir(parents=True)
    (tmp_path / "two/model-1").mkdir()
    line = mistake(capsys, "two")
    assert "two: holds 2 members; name one, such as two/model-0" in line
    assert "nowhere" in mistake(capsys, "nowhere")
    (tmp_path / "mine/config.json").write_text("{")
    assert "is not JSON; the inverter's metadata are damaged" in mistake(capsys, folder)
