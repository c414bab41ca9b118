"""Data sets: splits, files that are the same byte for byte, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load, save

import ikgrad as ik
from ikgrad.data import DataSet, JointBox, SmoothPath, generate
from ikgrad.data.dataset import _checksum, scheme_from_recipe

ROBOT = ik.load_robot("denso_vp6242")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return generate(ROBOT, SmoothPath(count=40, seed=2)).save(tmp_path / "path.safetensors")


def test_the_split_covers_every_row_once():
    data = generate(ROBOT, JointBox(count=4000))
    parts = (data.train, data.validation, data.test)
    assert [len(part.q) for part in parts] == [2800, 600, 600]
    together = torch.cat([part.q[:, 0] for part in parts]).sort().values
    assert torch.equal(together, data.samples.q[:, 0].sort().values)
    assert data.recipe["split"] == {"train": 2800, "validation": 600, "test": 600}


def test_the_split_is_random_but_seeded():
    first, second = (generate(ROBOT, JointBox(count=100, seed=seed)).part for seed in (0, 1))
    assert not torch.equal(first, second)
    assert (first.diff() != 0).sum() > 10


def test_a_round_trip_changes_nothing(path: Path):
    data = DataSet.load(path, robot=ROBOT)
    made = generate(ROBOT, SmoothPath(count=40, seed=2))
    assert data.scheme == made.scheme
    assert data.to_bytes() == path.read_bytes()
    for ours, theirs in zip((*data.samples, data.part), (*made.samples, made.part), strict=True):
        assert torch.equal(ours, theirs)


def test_the_recipe_makes_the_file_again(path: Path):
    recipe = DataSet.load(path, robot=ROBOT).recipe
    split = recipe.pop("split")
    again = generate(ROBOT, scheme_from_recipe(json.loads(json.dumps(recipe))))
    assert again.recipe["split"] == split
    assert again.to_bytes() == path.read_bytes()


def test_files_are_overwritten_on_demand_only(path: Path, tmp_path: Path):
    data = generate(ROBOT, JointBox(count=5))
    with pytest.raises(ik.DataError, match="exists already"):
        data.save(path)
    assert DataSet.load(data.save(path, force=True), robot=ROBOT).scheme == JointBox(count=5)
    with pytest.raises(ik.DataError, match=r"unknown kind of file '\.csv'"):
        data.save(tmp_path / "data.csv")


def test_data_of_another_robot_are_refused(path: Path):
    other = ik.load_robot("denso_vp6242", tip="flange")
    with pytest.raises(ik.RobotError, match="data of robot 'denso_vp6242' with fingerprint") as caught:
        DataSet.load(path, robot=other)
    assert ROBOT.fingerprint in str(caught.value)
    assert other.fingerprint in str(caught.value)


def rewrite(path: Path, change: Callable[[dict, dict], object], *, checksum: bool = True) -> None:
    """Change the numbers or the header of a file, with a right or a wrong checksum."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    about = json.loads(json.loads(content[8 : 8 + length])["__metadata__"]["ikgrad"])
    tensors = load(content)
    change(about, tensors)
    if checksum and "sha256" in about:
        about["sha256"] = _checksum(tensors)
    path.write_bytes(save(tensors, metadata={"ikgrad": json.dumps(about)}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda about, t: t["q"].__setitem__((3, 1), torch.nan), r"q\[3, 1\] is not finite"),
        (lambda about, t: t.update({name: x[:0] for name, x in t.items()}), "the data set is empty"),
        (lambda about, t: t.update(T=t["T"][:-1]), r"T must have shape \(40, 4, 4\), got \(39, 4, 4\)"),
        (lambda about, t: t.pop("part"), "lacks part; generate the data anew"),
        (lambda about, t: about.pop("recipe"), "lacks recipe; generate the data anew"),
        (lambda about, t: about.update(format="x"), "holds no data of this version of ikgrad"),
        (lambda about, t: about["recipe"].update(scheme="cub"), "unknown sampling scheme 'cub'; did you mean 'cube'"),
        (lambda about, t: about["recipe"].update(radius=1), "scheme 'smooth_path': unknown key 'radius'"),
        (lambda about, t: about["recipe"].update(count="many"), "key 'count' must be of type int, got 'many'"),
    ],
)
def test_files_that_cannot_be_used_are_refused(path: Path, change: Callable[[dict, dict], object], message: str):
    rewrite(path, change)
    with pytest.raises(ik.DataError, match=message):
        DataSet.load(path, robot=ROBOT)


def test_changed_numbers_and_cut_files_are_refused(path: Path, tmp_path: Path):
    rewrite(path, lambda about, tensors: tensors["q"].mul_(2), checksum=False)
    with pytest.raises(ik.DataError, match="the numbers were changed since they were written"):
        DataSet.load(path, robot=ROBOT)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(ik.DataError, match="is not a data file, or is damaged"):
        DataSet.load(path, robot=ROBOT)
    with pytest.raises(ik.DataError, match="no such file"):
        DataSet.load(tmp_path / "none.safetensors", robot=ROBOT)


@pytest.mark.parametrize("shares", [(0.5, 0.5), (-0.1, 0.2)])
def test_shares_that_leave_nothing_are_refused(shares: tuple[float, float]):
    with pytest.raises(ik.ConfigError, match="must be shares that leave some rows"):
        generate(ROBOT, JointBox(count=10), validation=shares[0], test=shares[1])


def test_a_data_set_cannot_be_changed():
    data = generate(ROBOT, JointBox(count=10))
    with pytest.raises(AttributeError):
        data.part = data.part + 1
    assert replace(data).scheme is data.scheme
