"""Inverters on disk: the same answers come back, and weights that do not belong are refused, with the reason."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

import ikgrad as ik
from ikgrad.networks import storage
from ikgrad.resources import builtin_file

ROBOT = ik.load_robot("denso_vp6242")
Q = ik.sample_configurations(ROBOT, 40, seed=0)
T = ik.forward_kinematics(ROBOT, Q)


def make(**options: Any) -> ik.Inverter:
    inverter = ik.Inverter(ROBOT, **options)
    return inverter.fit(T, Q, Q if inverter.feedback else None)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make().save(tmp_path / "mine")


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "config.json"
    config = json.loads(path.read_text())
    change(config)
    path.write_text(json.dumps(config))


@pytest.mark.parametrize("feedback", [False, True])
@pytest.mark.parametrize(
    "options", [{}, {"hidden": (8, 4), "activation": "silu", "bounded": True, "encoding": "quaternion"}]
)
def test_a_round_trip_gives_the_same_answers(tmp_path: Path, feedback: bool, options: dict[str, Any]):
    inverter = make(feedback=feedback, **options)
    again = ik.load_inverter(inverter.save(tmp_path / "mine"))
    arguments = (T, Q)[: 1 + feedback]
    assert torch.equal(again(*arguments), inverter(*arguments))
    assert again.robot.fingerprint == ROBOT.fingerprint
    assert again.fit(*((T[:9], Q[:9], Q[:9])[: 2 + feedback])).reference.equal(inverter.reference)


def test_the_folder_says_what_the_weights_are_for(folder: Path):
    assert {path.name for path in folder.iterdir()} == {"model.safetensors", "config.json"}
    config = json.loads((folder / "config.json").read_text())
    assert config["robot"]["fingerprint"] == ROBOT.fingerprint
    assert config["robot"]["joint_names"] == [f"joint_{k}" for k in range(1, 7)]
    assert config["features"][0] == "x [m]"
    assert config["weights_sha256"] == hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()
    assert set(config["versions"]) == {"ikgrad", "torch", "python"}


def test_a_folder_is_replaced_on_demand_only(folder: Path):
    with pytest.raises(ik.DataError, match=r"mine: exists already; it is replaced with force=True only"):
        make(seed=1).save(folder)
    newer = make(seed=1)
    newer.save(folder, force=True)
    assert torch.equal(ik.load_inverter(folder)(T), newer(T))
    assert [path.name for path in folder.parent.iterdir()] == ["mine"]


def test_other_folders_are_never_replaced(tmp_path: Path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "me.jpg").write_text("x")
    with pytest.raises(ik.DataError, match="photos: exists and holds no inverter"):
        make().save(tmp_path / "photos", force=True)
    with pytest.raises(ik.DataError, match=r"the folder '.*missing' does not exist; create it first"):
        make().save(tmp_path / "missing" / "mine")


def test_a_failed_save_leaves_the_old_one(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ikgrad.networks.storage._write", full)
    with pytest.raises(ik.DataError, match="cannot write the inverter: No space left on device"):
        make(seed=1).save(folder, force=True)
    assert torch.equal(ik.load_inverter(folder)(T), make()(T))
    assert [path.name for path in folder.parent.iterdir()] == ["mine"]


def test_weights_of_another_robot_are_refused_with_both_fingerprints(folder: Path):
    other = ik.load_robot("ur5e")
    with pytest.raises(ik.RobotError, match=r"joint names .*shoulder_pan_joint.*") as caught:
        ik.load_inverter(folder, robot=other)
    assert ROBOT.fingerprint in str(caught.value)
    assert other.fingerprint in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        (
            'xyz="0.21 0 0"',
            'xyz="0.211 0 0"',
            r"geometry of joint_3 xyz 0\.21( 0 0 rpy 0 0 0, revolute by 1 q \+0 along 0 0 1), now joint_3 xyz 0\.211\1",
        ),
        ('"joint_4"', '"elbow"', r"joint names \['joint_1', .*'joint_4'.*now .*'elbow', 'joint_5', 'joint_6'\]"),
        ('"joint_4"', '"joint_5"', r"joint names .*'joint_4', 'joint_5', .*now .*'joint_5', 'joint_4', 'joint_6'\]"),
        ('lower="-2.09', 'lower="-2.08', r"limits of joint_5 \[-2\.09\d*, (2\.09\d*)\], now \[-2\.08\d*, \1\]"),
    ],
    ids=["1 mm", "another name", "another order", "a limit"],
)
def test_a_changed_urdf_is_refused_with_both_fingerprints(
    folder: Path, tmp_path: Path, old: str, new: str, differs: str
):
    text = builtin_file("urdf", "denso_vp6242").read_text()
    assert old in text
    path = tmp_path / "denso_vp6242.urdf"
    path.write_text(text.replace(new, "*").replace(old, new).replace("*", old))  # swaps the two if both are there
    changed = ik.load_robot(path)
    wanted = f"with fingerprint {ROBOT.fingerprint}, not for 'denso_vp6242' with {changed.fingerprint}; what differs: "
    with pytest.raises(ik.RobotError, match=f"{re.escape(wanted)}{differs}$") as caught:
        ik.load_inverter(folder, robot=changed)
    assert "\n" not in str(caught.value)


def test_folders_that_do_not_tell_their_geometry_are_read_and_compared(folder: Path, tmp_path: Path):
    edit(folder, lambda config: config["robot"].pop("geometry"))
    assert torch.equal(ik.load_inverter(folder)(T), make()(T))
    path = tmp_path / "denso_vp6242.urdf"
    path.write_text(builtin_file("urdf", "denso_vp6242").read_text().replace('xyz="0.21 0 0"', 'xyz="0.211 0 0"'))
    with pytest.raises(ik.RobotError, match=r"what differs: the geometry of the links$"):
        ik.load_inverter(folder, robot=ik.load_robot(path))


def test_another_tip_or_base_is_refused(folder: Path):
    with pytest.raises(ik.RobotError, match="what differs: tip gripper, now flange"):
        ik.load_inverter(folder, robot=ik.load_robot("denso_vp6242", tip="flange"))
    with pytest.raises(ik.RobotError, match="base base_link, now link_1"):
        ik.load_inverter(folder, robot=ik.load_robot("denso_vp6242", base="link_1"))


def test_the_stored_tip_is_loaded_and_an_unknown_robot_must_be_given(tmp_path: Path):
    flange = ik.load_robot("denso_vp6242", tip="flange")
    inverter = ik.Inverter(flange).fit(T, Q)
    assert ik.load_inverter(inverter.save(tmp_path / "flange")).robot.tip == "flange"
    tooled = ROBOT.with_tool(torch.eye(4))
    inverter = ik.Inverter(tooled).fit(T, Q)
    inverter.save(tmp_path / "tooled")
    with pytest.raises(ik.RobotError, match=r"not built in; give it: load_inverter\(path, robot=\.\.\.\)"):
        ik.load_inverter(tmp_path / "tooled")
    assert torch.equal(ik.load_inverter(tmp_path / "tooled", robot=tooled)(T), inverter(T))


@pytest.mark.parametrize("harm", ["cut", "flip", "empty", "swap"])
def test_damaged_weights_are_refused(folder: Path, tmp_path: Path, harm: str):
    path = folder / "model.safetensors"
    content = bytearray(path.read_bytes())
    if harm == "swap":
        content = bytearray((make(seed=1).save(tmp_path / "other") / "model.safetensors").read_bytes())
    if harm == "flip":
        content[-1] ^= 1
    path.write_bytes({"cut": content[:-8], "empty": b""}.get(harm, content))
    wanted = (
        r"the weights are truncated or were changed since they were saved: \d+ bytes with checksum \w{16}, not \w{16}$"
    )
    with pytest.raises(ik.DataError, match=wanted):
        ik.load_inverter(folder)


def test_weights_that_are_no_weights_are_refused(folder: Path):
    (folder / "model.safetensors").write_bytes(b"hello")
    edit(folder, lambda config: config.update(weights_sha256=hashlib.sha256(b"hello").hexdigest()))
    with pytest.raises(ik.DataError, match="is not a safetensors file"):
        ik.load_inverter(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["network"].clear(), "the metadata lack feedback, hidden, activation"),
        (lambda c: c.update(network=3), "the metadata lack feedback"),
        (lambda c: c.update(format="other"), "is no inverter of this version of ikgrad"),
        (
            lambda c: c["network"].update(hidden=[11]),
            r"configuration: network\.biases\.0 is \(1, 10\) in the weights and \(1, 11\) by the configuration$",
        ),
        (
            lambda c: c["network"].update(hidden=[10, 10]),
            r"network\.biases\.1 is \(1, 6\) in the weights and \(1, 10\) by the configuration$",
        ),
        (lambda c: c.update(family="oracle"), r"unknown family 'oracle' .*known: classic, increment, unrolled\)$"),
        (lambda c: c["network"].update(hidden="many"), "the weights do not fit the configuration"),
        (lambda c: c["network"].update(activation="tan"), "fit the configuration: unknown activation 'tan'"),
        (lambda c: c["network"].update(dtype="float65"), "the weights do not fit the configuration"),
        (lambda c: c.update(features=["x"]), "features of other names"),
    ],
)
def test_metadata_that_lack_or_contradict_are_refused(folder: Path, change: Callable[[Any], object], message: str):
    edit(folder, change)
    with pytest.raises(ik.DataError, match=message):
        ik.load_inverter(folder)


@pytest.mark.parametrize("family", storage._FAMILIES)
def test_metadata_that_lack_any_key_are_refused(tmp_path: Path, family: str):
    makers = {"classic": make, "increment": ik.IncrementInverter, "unrolled": ik.UnrolledInverter}
    inverter = make() if family == "classic" else makers[family](ROBOT, width=4, depth=1)
    path = inverter.save(tmp_path / "mine") / "config.json"
    whole = path.read_text()
    for part, keys in (
        (None, storage._KEYS[1:]),
        ("robot", storage._ROBOT_KEYS),
        ("network", storage._FAMILIES[family][1]),
    ):
        for key in keys:
            config = json.loads(whole)
            (config if part is None else config[part]).pop(key)
            path.write_text(json.dumps(config))
            with pytest.raises(
                ik.DataError, match=f"the metadata lack (.*, )?{key}.*; the weights cannot be trusted without$"
            ):
                ik.load_inverter(tmp_path / "mine")


def test_missing_files_are_refused(folder: Path, tmp_path: Path):
    with pytest.raises(ik.DataError, match="cannot read the inverter's metadata: No such file"):
        ik.load_inverter(tmp_path / "nothing")
    (folder / "model.safetensors").unlink()
    with pytest.raises(ik.DataError, match="cannot read the weights: No such file"):
        ik.load_inverter(folder)
    (folder / "config.json").write_text("{")
    with pytest.raises(ik.DataError, match="is not JSON"):
        ik.load_inverter(folder)
