"""Inverters by name: the weights in the package, what hides them, and what there is to say about other names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.evaluation import evaluate
from ikgrad.networks.places import READY_MADE, find_inverter, ready_made
from ikgrad.resources import builtin_file, builtin_names, data_folder

FOLDER = data_folder(READY_MADE)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ready_made())
def test_every_one_is_for_its_robot_and_better_than_the_plain_steps_that_it_holds(name: str):
    inverter = ik.load_inverter(name)
    assert inverter.robot.fingerprint == ik.load_robot(name).fingerprint
    task = TaskStream(inverter.robot, batch_size=4000, seed=99)
    found = evaluate(inverter, task, solver_steps=0, plain_steps=(inverter.rounds,))
    assert found.rows[0].errors.close > found.rows[1].errors.close
    assert found.rows[0].errors.position_mm[0] < 2.0
    assert found.rows[0].errors.rotation_deg[0] < 0.2


@pytest.mark.parametrize("name", ready_made())
def test_every_one_comes_with_its_report(name: str):
    files = {path.name for path in (FOLDER / name).iterdir()}
    assert {"config.json", "model.safetensors", "report.json"} <= files
    assert json.loads((FOLDER / name / "report.json").read_text())


def test_they_are_small_and_for_robots_that_are_built_in():
    assert "panda" in ready_made()
    assert set(ready_made()) <= set(builtin_names("urdf"))
    assert sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()) < 2e6


def test_a_folder_goes_before_a_ready_made_name(tmp_path: Path):
    mine = ik.UnrolledInverter(ik.load_robot("panda"), rounds=1, width=4, depth=1)
    mine.save(tmp_path / "panda")
    assert ik.load_inverter("panda").rounds == 1
    shutil.rmtree(tmp_path / "panda")
    assert ik.load_inverter("panda").rounds == 4


def test_a_folder_that_hides_a_name_is_said_to(tmp_path: Path):
    (tmp_path / "panda").mkdir()
    with pytest.raises(
        ik.DataError, match="panda: this folder holds no trained inverter, and hides the ready-made one"
    ):
        ik.load_inverter("panda")


def test_a_run_folder_stands_for_its_model(tmp_path: Path):
    mine = ik.UnrolledInverter(ik.load_robot("panda"), rounds=1, width=4, depth=1)
    (tmp_path / "run").mkdir()
    with pytest.raises(ik.DataError, match=r"run: holds no trained inverter$"):
        ik.load_inverter("run")
    mine.save(tmp_path / "run" / "model")
    assert find_inverter("run") == Path("run/model")
    assert ik.load_inverter(tmp_path / "run").rounds == 1


def test_the_members_of_an_ensemble_must_be_named(tmp_path: Path):
    (tmp_path / "run" / "model-0").mkdir(parents=True)
    with pytest.raises(ik.DataError, match="run: holds 1 members; name one, such as run/model-0"):
        ik.load_inverter("run")


def test_the_wrong_robot_and_the_wrong_tip_are_refused_with_both_fingerprints():
    panda = ik.load_robot("panda")
    for other, differs in (
        (ik.load_robot("iiwa14"), "joint names"),
        (ik.load_robot("panda", tip="panda_link7"), "tip panda_link8, now panda_link7"),
        (panda.with_tool(torch.eye(4)), "tip panda_link8, now"),
    ):
        with pytest.raises(ik.RobotError, match=f"what differs: {differs}") as caught:
            ik.load_inverter("panda", robot=other)
        assert panda.fingerprint in str(caught.value)
        assert other.fingerprint in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_changed_urdf_of_the_same_name_is_refused(tmp_path: Path):
    path = tmp_path / "panda.urdf"
    path.write_text(builtin_file("urdf", "panda").read_text().replace("0.384", "0.385"))
    with pytest.raises(ik.RobotError, match=r"geometry of panda_joint5 xyz -0\.0825 0\.384 0 .*now .* 0\.385 0 "):
        ik.load_inverter("panda", robot=ik.load_robot(path))
    same = tmp_path / "same.urdf"
    same.write_text(builtin_file("urdf", "panda").read_text())
    assert ik.load_inverter("panda", robot=ik.load_robot(same)).robot.name == "panda"


def test_a_robot_without_weights_gets_the_command_that_trains_them(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("ikgrad.networks.places.ready_made", lambda: ["panda"])
    with pytest.raises(
        ik.DataError,
        match=r"no weights for robot 'arm4' come with the package \(there are: panda\); train them: "
        r"ikgrad train --robot arm4 --model unrolled --out runs/arm4, and name that folder$",
    ):
        ik.load_inverter("arm4")


def test_an_unknown_name_is_answered_with_those_that_there_are():
    with pytest.raises(
        ik.UnknownNameError,
        match=r"unknown folder or ready-made inverter 'pandas'; did you mean 'panda'\? \(known: .*panda",
    ):
        ik.load_inverter("pandas")
