"""``ikgrad view``: what it refuses, what it writes, how it starts and ends."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import ikgrad as ik
from ikgrad.cli.main import main

installed = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="needs viser")


def mistake(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["view", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_a_missing_extra_is_named(capsys, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "viser" else found(name, *rest)
    )
    assert "pip install 'ikgrad[viz]'" in mistake(capsys, "--robot", "panda")


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_a_port_that_is_none_is_refused(capsys, port: str):
    assert "expected a port from 0 to 65535" in mistake(capsys, "--robot", "panda", f"--port={port}")


@installed
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--robot", "pandaa"], "did you mean 'panda'"),
        (["--robot", "panda", "--q", "0,0"], "q must"),
        (["--robot", "panda", "--q", "9,9,9,9,9,9,9"], "inside the joint limits"),
        (["--robot", "panda", "--sphere", "1,2,3"], "--sphere takes four numbers"),
        (["--robot", "panda", "--sphere", "1,2,3,-1"], "radii must be positive"),
        (["--robot", "panda", "--path", "nothing.csv"], "nothing.csv: no such file"),
        (["--robot", "panda", "--inverter", "nothing"], "unknown folder or ready-made inverter"),
        (["--robot", "ur5e", "--inverter", "panda"], "ur5e"),
        (["--robot", "panda", "--export", "page.png"], "unknown kind of file '.png'"),
        ([], "--robot is missing; only a path of a study brings its own robot (apps, puma"),
        (["--path", "aps"], "--robot is missing"),
        (["--robot", "panda", "--path", "aps"], "unknown path 'aps'; did you mean 'apps'?"),
        (["--robot", "panda", "--path", "apps"], "of the built-in robot 'kr210', not of 'panda' as given"),
        (["--robot", "panda", "--meshes", "."], "built-in robots have no meshes"),
        (["--path", "puma", "--meshes", "."], "built-in robots have no meshes"),
    ],
)
def test_mistakes_are_one_line(capsys, options: list[str], words: str):
    assert words in mistake(capsys, *options)


@installed
def test_a_port_in_use_is_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"cannot listen on 127.0.0.1, port {port}" in mistake(capsys, "--robot", "arm4", "--port", str(port))


@installed
def test_solved_joints_go_into_a_page(capsys, tmp_path: Path):
    joints, page = tmp_path / "joints.csv", tmp_path / "motion.html"
    robot = ik.load_robot("ur5e")
    np.save(tmp_path / "q.npy", ik.sample_configurations(robot, 5, seed=0).numpy())
    assert main(["fk", "--robot", "ur5e", str(tmp_path / "q.npy"), "-o", str(tmp_path / "poses.csv")]) == 0
    assert main(["solve", "--robot", "ur5e", str(tmp_path / "poses.csv"), "-o", str(joints)]) == 0
    capsys.readouterr()
    assert main(["view", "--robot", "ur5e", "--path", str(joints), "--export", str(page)]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(rf"ur5e -> {page} \(\d\.\d MB\)\n", out)
    assert err == ""
    assert "__VISER_EMBED_DATA__" in page.read_text(encoding="utf-8")
    assert "exists already" in mistake(capsys, "--robot", "ur5e", "--export", str(page))


@installed
def test_a_path_of_a_study_brings_its_robot(capsys, tmp_path: Path):
    assert main(["view", "--path", "trajectory", "--export", str(tmp_path / "page.html")]) == 0
    assert capsys.readouterr().out.startswith("arm4 -> ")


@installed
def test_what_meshes_cannot_be_read_is_one_line(capsys, tmp_path: Path):
    box = "<visual><geometry><box size='0.1 0.1 0.1'/></geometry></visual>"
    lost = "<visual><geometry><mesh filename='package://arm/lost.stl'/></geometry></visual>"
    joint = "<parent link='a'/><child link='b'/><limit lower='-1' upper='1' effort='1' velocity='1'/>"
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        f"<robot name='arm'><link name='a'>{box}</link><link name='b'>{lost}</link>"
        f"<joint name='j' type='revolute'>{joint}<origin xyz='0 0 1'/></joint></robot>"
    )
    page = tmp_path / "page.html"
    assert main(["view", "--robot", str(urdf), "--meshes", str(tmp_path), "--export", str(page)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("arm -> ")
    assert err == f"ikgrad: b: 'package://arm/lost.stl' is not under {tmp_path}; drawn as capsules\n"


@installed
def test_it_serves_the_page_until_ctrl_c(tmp_path: Path):
    code = (
        "import signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background may ignore it\n"
        "from ikgrad.cli.main import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", code, "view", "--robot", "arm4", "--port", "0", "--no-browser"]
    quiet = {**os.environ, "PYTHONWARNINGS": "default"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=quiet)
    try:
        line = process.stdout.readline()
        url = re.fullmatch(r"arm4: (http://127\.0\.0\.1:\d+) \(Ctrl-C ends it\)\n", line)[1]
        with urllib.request.urlopen(url, timeout=30) as answer:
            assert b"<html" in answer.read().lower()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (0, "", "ikgrad: the page is closed\n")
