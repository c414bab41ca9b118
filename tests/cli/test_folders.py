"""``ikgrad solve``, ``sample`` and ``merge`` over folders: what is said, and what is refused before any work."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from job_folders import hard_poses, hashes, run_here, write_folder
from support import mistake

import ikgrad as ik
from ikgrad.cli import folders
from ikgrad.cli.main import main

ROBOT = ["--robot", "puma560"]


@pytest.fixture(scope="module")
def robot() -> ik.Robot:
    return ik.load_robot("puma560")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch, robot) -> Path:
    """A folder ``poses`` of three partitions, and everything in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikgrad.cli.terminal.PATIENCE", 1000.0)
    monkeypatch.setattr("ikgrad.jobs.run_local", run_here)
    write_folder(tmp_path / "poses", {f"p{k}": T for k, T in enumerate(hard_poses(robot, 60).split(20))})
    return tmp_path


def solve(*argv: str) -> int:
    return main(["solve", *ROBOT, *argv])


def wrong(capsys, *argv: str) -> str:
    return mistake(capsys, *argv[:1], *ROBOT, *argv[1:])


def test_a_folder_is_solved_verified_and_refused_a_second_time(capsys, place):
    assert solve("poses", "-o", "joints") == 0
    out = capsys.readouterr().out
    assert "ikgrad solve: puma560, lm" in out
    assert "of 60 (" in out
    assert "3 done" in out
    assert "time of the workers" in out
    assert "not finite or have a number missing." in out
    assert pq.read_table(place / "joints").num_rows == 60  # readers pass over what begins with _
    before = hashes(place / "joints")
    assert "joints: holds a finished job; --resume verifies it" in wrong(capsys, "solve", "poses", "-o", "joints")
    (place / "joints/p1.parquet").write_bytes(b"")
    assert solve("poses", "-o", "joints", "--resume") == 0
    out = capsys.readouterr().out
    assert "1 done, 2 found finished" in out
    assert "'p1' has 0 bytes, had" in out
    assert hashes(place / "joints") == before
    assert solve("poses", "-o", "joints", "--force", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["poses"] == 60
    assert document["done"] == document["partitions"] == 3
    assert sum(document["failed"].values()) + document["solved"] == 60


def test_a_single_file_and_a_folder_say_the_same(capsys, place):
    assert solve("poses/p0.parquet", "-o", "single.parquet", "--json") == 0
    single = json.loads(capsys.readouterr().out)
    (place / "one").mkdir()
    (place / "poses/p0.parquet").rename(place / "one/p0.parquet")
    assert solve("one", "-o", "joints", "--json") == 0
    folder = json.loads(capsys.readouterr().out)
    assert {name: folder[name] for name in single if name in folder and "second" not in name and name != "output"} == {
        name: single[name] for name in single if name in folder and "second" not in name and name != "output"
    }


def test_shards_share_a_folder_and_the_last_one_writes_the_manifest(capsys, place):
    assert solve("poses", "-o", "whole") == 0
    assert solve("poses", "-o", "joints", "--shard", "1/2", "--json") == 0
    capsys.readouterr()
    assert solve("poses", "-o", "joints", "--shard", "4/4", "--json") == 0  # nothing to do for it
    document = json.loads(capsys.readouterr().out)
    assert (document["done"], document["left_for_other_shards"]) == (0, 1)
    assert "partition 'p1' is missing of 3 in joints" in mistake(capsys, "merge", "joints")
    assert not (place / "joints/_manifest.json").exists()
    assert solve("poses", "-o", "joints", "--shard", "2/2") == 0
    assert "left for other shards" not in capsys.readouterr().out
    assert hashes(place / "joints") == hashes(place / "whole")
    assert main(["merge", "joints"]) == 0
    assert "3, all verified" in capsys.readouterr().out
    assert hashes(place / "joints") == hashes(place / "whole")


def test_merge_of_folders(capsys, place):
    for k in (1, 2):
        assert solve("poses", "-o", f"s{k}", "--shard", f"{k}/2") == 0
    capsys.readouterr()
    assert "several folders come together in one: name it with -o OUT" in mistake(capsys, "merge", "s1", "s2")
    assert main(["merge", "s1", "s2", "-o", "joints", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["partitions"], document["rows"], document["brought"]) == (3, 60, 3)
    assert not (place / "s1").exists()


def test_samples_are_solved(capsys, place):
    argv = ["sample", *ROBOT, "--count", "50", "-o", "more", "--joints", "q", "--partition-rows", "20"]
    assert main(argv) == 0
    assert "50" in capsys.readouterr().out
    assert len(list((place / "q").glob("*.parquet"))) == 3
    assert "more: holds a finished job" in mistake(capsys, *argv)
    assert main([*argv, "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["found_finished"] == 3
    assert solve("more", "-o", "joints", "--json") == 0
    assert json.loads(capsys.readouterr().out)["solved"] == 50


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--q0", "q.npy"], "--q0 is for a single file of poses, and POSES is a folder"),
        (["--plot", "a.png"], "--plot is for a single file"),
        (["--chunk", "9"], "--chunk is for a single file"),
        (["--shard", "3/2"], "expected a shard i/N with i from 1 to N, like 1/8 to 8/8, got '3/2'"),
        (["--address", "auto"], "--address is that of a Ray cluster; it needs --engine ray"),
        (["--address", "auto", "--engine", "ray"], "--address needs --workers: how many the cluster shall run"),
        (["--robot", "pandda"], "unknown robot 'pandda'"),
    ],
)
def test_options_that_make_no_sense_for_a_folder(capsys, place, options, said):
    assert said in wrong(capsys, "solve", "poses", "-o", "joints", *options)
    assert not (place / "joints").exists()


@pytest.mark.parametrize("option", ["--engine=local", "--address=a", "--workers=2", "--threads=1", "--shard=1/2"])
def test_options_that_make_no_sense_for_a_file(capsys, place, option):
    name = option.partition("=")[0]
    line = wrong(capsys, "solve", "poses/p0.parquet", "-o", "q.csv", option)
    assert f"{name} is for a folder of poses, and POSES is a file" in line
    line = wrong(capsys, "sample", "--count", "9", "-o", "p.csv", option)
    assert f"{name} is for a folder of poses; POSES has a suffix, so it is a file" in line
    assert "--partition-rows is for a folder" in wrong(
        capsys, "sample", "--count", "9", "-o", "p.csv", "--partition-rows", "3"
    )


def test_ray_gets_what_was_asked_for(capsys, place, monkeypatch):
    asked = {}

    def run_ray(task, names, **options):
        asked.update(options)
        return run_here(task, names, workers=1, threads=1)

    monkeypatch.setattr(folders, "check", lambda name, **extra: None)  # as if Ray were there
    monkeypatch.setattr("ikgrad.jobs.ray_engine.run_ray", run_ray)
    options = ["--engine", "ray", "--workers", "3", "--threads", "2", "--address", "a:1"]
    assert solve("poses", "-o", "joints", *options) == 0
    assert asked == {"workers": 3, "threads": 2, "address": "a:1"}


def test_outputs_that_cannot_be(capsys, place):
    (place / "file").write_text("")
    for output, said in [
        ("joints.csv", "joints.csv: names a file, and a folder of partitions is to be written; leave out the suffix"),
        ("poses", "poses: is the input; choose another folder for the output"),
        ("./poses/../poses", "is the input"),
        ("poses/out", "the folders of input and output lie inside one another; put them side by side"),
        (".", "the folders of input and output lie inside one another"),
        ("none/out", "the folder 'none' does not exist; create it first"),
        ("file", "file: is a file, not a folder"),
    ]:
        assert said in wrong(capsys, "solve", "poses", "-o", output)
    assert sorted(path.name for path in place.iterdir()) == ["file", "poses"]
    assert len(list((place / "poses").iterdir())) == 3


def test_inputs_that_cannot_be(capsys, place):
    (place / "empty").mkdir()
    (place / "broken").mkdir()
    (place / "broken/a.parquet").write_text("no")
    for poses, said in [
        ("none", "none: no such file or folder"),
        ("empty", "empty: holds no .parquet files"),
        ("broken", "a.parquet: is not a readable Parquet file"),
    ]:
        assert said in wrong(capsys, "solve", poses, "-o", "joints")
    assert not (place / "joints").exists()


def test_sobol_and_the_same_folder_twice(capsys, place):
    assert "--sobol is for a single file" in wrong(capsys, "sample", "--count", "9", "-o", "out", "--sobol")
    for joints in ("./out", "out/q", "."):
        line = wrong(capsys, "sample", "--count", "9", "-o", "out", "--joints", joints)
        assert "-o and --joints name the same folder, or one inside the other" in line
    assert "leave out the suffix" in wrong(capsys, "sample", "--count", "9", "-o", "out", "--joints", "q.csv")


def test_a_full_disk_and_ctrl_c_keep_what_is_finished(capsys, place, monkeypatch):
    for number, (error, status, said) in enumerate(
        [
            (OSError(28, "No space left on device", "x.parquet"), 2, "x.parquet: No space left on device; 1 of 3"),
            (KeyboardInterrupt(), 130, "interrupted; 1 of 3"),
        ]
    ):

        def stopped(task, names, *, workers, threads, error=error):
            yield task(names[0])
            raise error

        monkeypatch.setattr("ikgrad.jobs.run_local", stopped)
        assert solve("poses", "-o", f"j{number}") == status
        err = capsys.readouterr().err
        assert err == (
            f"ikgrad: {said} partitions are finished and kept in j{number}, "
            "the same command with --resume goes on from there\n"
        )
        assert "--resume goes on with it, --force starts anew" in wrong(capsys, "solve", "poses", "-o", f"j{number}")


def test_a_robot_whose_joints_are_named_like_results_is_refused_at_once(capsys, place):
    text = Path("steps.urdf")
    urdf = '<robot name="r"><link name="a"/><link name="b"/><joint name="steps" type="revolute"><parent link="a"/>'
    text.write_text(urdf + '<child link="b"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>')
    line = mistake(capsys, "solve", "--robot", "steps.urdf", "poses", "-o", "joints")
    assert "joint 'steps' is named like a column of results" in line
    assert "solve its files one by one, into .npz files" in line
