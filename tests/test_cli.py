"""The command line: help, tables, JSON, and one line for every mistake."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.cli.main import COMMANDS, build_parser, main
from ikgrad.cli.terminal import Progress, duration

COMMAND_LINES = [
    [],
    ["reproduce", "apps"],
    ["reproduce", "puma"],
    ["reproduce", "denso"],
    ["reproduce", "trajectory"],
    ["bench", "ik"],
    ["bench", "fk"],
    ["bench", "jacobian"],
    *([module.__name__.rsplit(".", 1)[1]] for module in COMMANDS),
]
HOME = "0,-0.3,0,-2.2,0,2,0.8"


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """No progress lines where a busy machine takes its time."""
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)


def mistake(capsys, *argv: str) -> str:
    """The one line that a mistake prints; asserts exit status 2 and nothing else."""
    assert main(list(argv)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def printed(capsys, *argv: str) -> str:
    assert main(list(argv)) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


# ---------------------------------------------------------------- help and start


@pytest.mark.parametrize("command", COMMAND_LINES, ids=" ".join)
def test_help_shows_an_example(capsys, command):
    assert "example:\n  ikgrad " in printed(capsys, *command, "--help")


@pytest.mark.parametrize("command", COMMAND_LINES, ids=" ".join)
def test_examples_are_accepted_by_the_parser(capsys, command):
    text = printed(capsys, *command, "--help").split("example:\n")[1]
    for line in text.strip().splitlines():
        assert build_parser().parse_args(line.split()[1:]).run


def test_version(capsys):
    python = ".".join(map(str, sys.version_info[:3]))
    assert printed(capsys, "--version") == f"ikgrad {ik.__version__} (torch {torch.__version__}, Python {python})\n"


def test_version_where_torch_is_missing(capsys, monkeypatch):
    def absent(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr("ikgrad.cli.main.version", absent)
    assert "(no torch, Python 3" in printed(capsys, "--version")


def test_the_parser_imports_nothing_heavy():
    code = "import sys; from ikgrad.cli.main import main; main(['--help']); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    heavy = {"torch", "numpy", "matplotlib", "pyarrow", "rich", "yourdfpy", "pytorch_kinematics", "numba"}
    assert not heavy & {name.split(".")[0] for name in done.stderr.split()}


# ---------------------------------------------------------------- mistakes in the command line

MISTAKES = {
    "": "COMMAND",
    "slove": "unknown 'slove'; did you mean 'solve'? (known: robots, fk, sample, solve, merge, map, train, evaluate,",
    "--versoin": "unknown option '--versoin'; did you mean '--version'?",
    "solve --rbot panda p.csv -o q.csv": "ikgrad solve: unknown option '--rbot'; did you mean '--robot'?",
    "solve --robot panda p.csv -o q.csv --sover=lm": "unknown option '--sover'; did you mean '--solver'?",
    "solve --robot panda p.csv -o q.csv --solver newtn": "unknown 'newtn'; did you mean 'newton'? (known: lm, apps,",
    "solve --robot panda p.csv -o q.csv --mask 1,1,1": "expected six zeros or ones like 1,1,1,0,0,0",
    "solve --robot panda p.csv -o q.csv --mask 0,0,0,0,0,0": "not all zero",
    "solve --robot panda p.csv -o q.csv --tol-pos -1": "--tol-pos: expected a number above 0, got '-1'",
    "solve --robot panda p.csv -o q.csv --tol-rot nan": "--tol-rot: expected a number above 0, got 'nan'",
    "solve --robot panda p.csv -o q.csv --solutions 0": "expected a whole number, at least 1, got '0'",
    "solve --robot panda p.csv -o q.csv --seed 1.5": "--seed: expected a whole number, at least 0, got '1.5'",
    "solve --robot panda p.csv": "the following arguments are required: -o/--output",
    "solve --robot panda p.csv -o q.txt": "q.txt: unknown kind of file '.txt' (known: .csv, .npz, .parquet)",
    "solve --robot panda p.csv -o q.csv": "p.csv: no such file",
    "solve --robot panda p.csv -o none/q.csv": "none/q.csv: the folder 'none' does not exist; create it first",
    "solve --robot pnda p.csv -o q.csv": "unknown robot 'pnda'; did you mean 'panda'? (known: arm4,",
    "solve --robot none.urdf p.csv -o q.csv": "none.urdf: no such file",
    "solve --robot panda --tip panda_lnik7 p.csv -o q.csv": "unknown link of panda.urdf 'panda_lnik7'; did you mean",
    "solve --robot panda p.csv -o q.csv --plot q.gif": "q.gif: unknown kind of file '.gif' (known: .png, .svg)",
    "sample --robot panda --count none -o p.csv": "expected a whole number, at least 1, got 'none'",
    "sample --robot panda --count 5 -o p.csv --joints p.csv": "-o and --joints name the same file",
    "fk --robot panda": "fk needs either --q Q1,Q2,... or a file of joint values",
    "fk --robot panda --q 1,2,3": "--q: expected 7 numbers (panda_joint1 [rad], panda_joint2 [rad],",
    "fk --robot panda --q 1,x,3": "--q: expected numbers with commas between, got '1,x,3'",
    "fk --robot panda --q 1,nan,3": "--q: expected numbers with commas between, got '1,nan,3'",
    "fk --robot panda q.csv": "q.csv: no such file",
    "robots --base panda_link0": "--base and --tip need --robot",
    "robots panda": "unrecognized arguments: panda",
    "reproduce aps": "unknown 'aps'; did you mean 'apps'?",
}


@pytest.mark.parametrize("line", MISTAKES, ids=lambda line: line or "nothing")
def test_a_mistake_is_one_line_and_leaves_no_file(capsys, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    assert MISTAKES[line] in mistake(capsys, *line.split())
    assert list(tmp_path.iterdir()) == []


BAD_ROBOTS = {
    "": "not a readable URDF",
    "<robot name='r'><link name='a'/></robot>": "has no joints",
    "<robot name='r'><link name='a'/><link name='b'/>"
    "<joint name='j' type='planar'><parent link='a'/><child link='b'/></joint></robot>": "'j' is of kind 'planar'",
    "<robot name='r'><link name='a'/><link name='b'/>"
    "<joint name='j' type='revolute'><parent link='a'/><child link='b'/>"
    "<axis xyz='0 0 1'/><limit lower='1' upper='-1' effort='1' velocity='1'/></joint></robot>": "swapped",
    "<robot name='r'><link name='a'/><link name='b'/>"
    "<joint name='j' type='continuous'><parent link='a'/><child link='b'/></joint>"
    "<joint name='k' type='continuous'><parent link='b'/><child link='a'/></joint></robot>": "cycle",
}


@pytest.mark.parametrize("text", BAD_ROBOTS, ids=BAD_ROBOTS.values())
def test_a_bad_robot_file_is_one_line(capsys, tmp_path, text):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    line = mistake(capsys, "robots", "--robot", str(path))
    assert str(path) in line
    assert BAD_ROBOTS[text] in line


def test_a_full_disk_is_one_line(monkeypatch, capsys, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device", str(tmp_path / "p.csv"))

    monkeypatch.setattr("ikgrad.files.writers.CsvWriter.append", full)
    line = mistake(capsys, "sample", "--robot", "arm4", "--count", "9", "-o", str(tmp_path / "p.csv"))
    assert line == f"ikgrad: {tmp_path / 'p.csv'}: No space left on device\n"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_is_one_line_and_status_130(monkeypatch, capsys, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ikgrad.files.writers.CsvWriter.append", interrupt)
    assert main(["sample", "--robot", "arm4", "--count", "9", "-o", str(tmp_path / "p.csv")]) == 130
    assert capsys.readouterr() == ("", "ikgrad: interrupted; nothing was written\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_stdout_that_is_full_is_one_line():
    command = [sys.executable, "-c", "import sys; from ikgrad.cli.main import main; sys.exit(main())", "robots"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (2, "ikgrad: cannot write: No space left on device\n")


def test_nobody_reading_any_more_is_quiet():
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-c", "import sys; from ikgrad.cli.main import main; sys.exit(main())", "robots"]
    with os.fdopen(write, "w") as closed:
        done = subprocess.run(command, stdout=closed, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (141, "")


# ---------------------------------------------------------------- robots


def test_robots_lists_every_built_in_robot(capsys):
    out = printed(capsys, "robots")
    assert "panda_link0 -> panda_link8" in out
    records = json.loads(printed(capsys, "robots", "--json"))
    assert [record["name"] for record in records] == sorted(record["name"] for record in records)
    assert {"panda", "ur5e", "iiwa14", "puma560", "kr210", "denso_vp6242", "arm4"} <= {r["name"] for r in records}
    assert all(record["name"] in out for record in records)


def test_one_robot_shows_its_joints_in_degrees(capsys):
    out = printed(capsys, "robots", "--robot", "kr210", "--tip", "link_3")
    assert [line.split() for line in out.splitlines() if "joint_1" in line] == [
        ["joint_1", "revolute", "-185", "185", "deg"]
    ]
    record = json.loads(printed(capsys, "robots", "--robot", "arm4", "--json"))
    assert record["joints"][0]["q_max"] is None  # JSON has no infinity
    assert record["fingerprint"] == ik.load_robot("arm4").fingerprint


# ---------------------------------------------------------------- fk and sample


def test_fk_of_one_configuration(capsys):
    document = json.loads(printed(capsys, "fk", "--robot", "panda", "--q", HOME, "--json"))
    q = torch.tensor([float(x) for x in HOME.split(",")], dtype=torch.float64)
    T = ik.forward_kinematics(ik.load_robot("panda"), q)
    assert document["pose"] == T.tolist()
    assert document["xyz_m"] == T[:3, 3].tolist()
    text = printed(capsys, "fk", "--robot", "panda", "--q", HOME)
    assert all(f"{value:.9f}" in text for value in document["quat_wxyz"])


def test_fk_takes_degrees_and_a_leading_minus(capsys):
    degrees = json.loads(printed(capsys, "fk", "--robot", "ur5e", "--q", "-90,0,90,0,0,0", "--deg", "--json"))
    half = torch.pi / 2
    radians = json.loads(printed(capsys, "fk", "--robot", "ur5e", "--q", f"{-half},0,{half},0,0,0", "--json"))
    np.testing.assert_allclose(degrees["pose"], radians["pose"], atol=1e-15)


def test_fk_says_which_joint_is_outside_its_limits(capsys):
    assert main(["fk", "--robot", "panda", "--q", "0,0,0,0,0,0,0"]) == 0
    assert "panda_joint4 = 0 is outside its limits -3.0718 to -0.0698" in capsys.readouterr().err


@pytest.mark.parametrize("extra", [[], ["--sobol"]])
def test_sample_and_fk_agree(capsys, tmp_path, extra):
    poses, joints, again = (str(tmp_path / name) for name in ("p.csv", "q.csv", "again.npy"))
    sample = ["sample", "--robot", "iiwa14", "--count", "20", "--seed", "3", *extra]
    assert "20 reachable poses of iiwa14" in printed(capsys, *sample, "-o", poses, "--joints", joints)
    printed(capsys, "fk", "--robot", "iiwa14", joints, "-o", again)
    robot = ik.load_robot("iiwa14")
    q = ik.sample_configurations(robot, 20, seed=3, sobol=bool(extra))
    np.testing.assert_allclose(np.load(again), ik.forward_kinematics(robot, q), atol=1e-15)
    assert printed(capsys, "fk", "--robot", "iiwa14", joints) == Path(poses).read_text()
    rows = list(csv.DictReader(io.StringIO(Path(poses).read_text())))
    assert len(rows) == 20
    document = json.loads(printed(capsys, "fk", "--robot", "iiwa14", joints, "--json"))
    assert document["poses"][4]["x_m"] == float(rows[4]["x_m"])


def test_existing_files_are_kept_unless_forced(capsys, tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("precious")
    command = ["sample", "--robot", "arm4", "--count", "2", "-o", str(path)]
    assert "exists already; it is overwritten with --force only" in mistake(capsys, *command)
    assert path.read_text() == "precious"
    printed(capsys, *command, "--force")
    assert path.read_text().startswith("x_m,")


# ---------------------------------------------------------------- progress


def test_quick_work_shows_no_progress(capsys):
    with Progress("work", 10, "rows") as progress:
        progress.advance(10)
    assert capsys.readouterr() == ("", "")


def test_slow_work_prints_lines_where_there_is_no_terminal(capsys, monkeypatch):
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 0.0)
    monkeypatch.setattr("ikgrad.cli.terminal.INTERVAL", 0.01)
    with Progress("work", 1000, "rows") as progress:
        progress.skip(500)
        progress.advance(100)
        while not (err := capsys.readouterr().err).count("left"):
            pass
    assert "ikgrad: work: 600 of 1,000 rows, " in err
    assert "rows/s, " in err


def test_slow_work_draws_a_bar_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    with Progress("work", 1000, "rows") as progress:
        progress.advance(250)
        while "25 %" not in screen.getvalue():
            pass


def test_durations_are_said_as_people_say_them():
    assert [duration(s) for s in (0.04, 9.99, 59.6, 61, 3725)] == [
        "0.0 s",
        "10.0 s",
        "1 min 0 s",
        "1 min 1 s",
        "1 h 2 min",
    ]
