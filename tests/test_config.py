"""Configurations: typed, strict, and refused with the file and the key."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest

from ikgrad.config import AppsConfig, StreamConfig, TrainConfig, load_config
from ikgrad.config.loading import describe_keys
from ikgrad.config.training import train_config
from ikgrad.errors import ConfigError, UnknownNameError
from ikgrad.resources import builtin_file, find_config


@pytest.fixture
def written(tmp_path: Path):
    def write(text: str) -> Path:
        path = tmp_path / "settings.yaml"
        path.write_text(text)
        return path

    return write


def test_the_built_in_configuration_is_the_default():
    assert load_config(AppsConfig, builtin_file("configs", "apps")) == AppsConfig()


def test_keys_that_are_left_out_keep_their_defaults(written):
    config = load_config(AppsConfig, written("seed: 7\nlearning_rates: [1, 0.2]\ntol_pos: 1e-5\n"))
    assert config == AppsConfig(seed=7, learning_rates=(1.0, 0.2), tol_pos=1e-5)
    assert isinstance(config.learning_rates[0], float)


def test_an_empty_file_is_the_default(written):
    assert load_config(AppsConfig, written("# nothing\n")) == AppsConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sed: 3", "unknown key 'sed'; did you mean 'seed'\\? \\(known: preset, "),
        ("seed: x", "key 'seed' must be of type int, got 'x'"),
        ("seed: 1.5", "key 'seed' must be of type int, got 1.5"),
        ("seed: true", "key 'seed' must be of type int, got True"),
        ("seed: null", "key 'seed' must be of type int, got None"),
        ("seed: -1", "seed must not be negative, got -1"),
        ("learning_rates: 3", "key 'learning_rates' must be of type tuple"),
        ("learning_rates: []", "learning_rates must be one or more positive numbers, got \\[\\]"),
        ("learning_rates: [0.1, -1]", "learning_rates must be one or more positive numbers"),
        ("tol_pos: 0", "tol_pos must be positive, got 0"),
        ("tol_rot: .nan", "tol_rot must be positive, got nan"),
        ("preset: best", "key 'preset' must be of type Literal\\['reproduces', 'printed'\\], got 'best'"),
        ("- 1", "expected lines of 'key: value', got list"),
        ("a: [", "not a YAML file"),
        ("\0", "not a YAML file"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_the_key(written, text: str, message: str):
    path = written(text)
    with pytest.raises(ConfigError, match=f"^{path}: .*{message}"):
        load_config(AppsConfig, path)


def test_a_missing_file_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"nothing\.yaml: cannot read the configuration: No such file"):
        load_config(AppsConfig, tmp_path / "nothing.yaml")


def test_settings_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        AppsConfig().seed = 1  # type: ignore[misc]


def test_reading_settings_does_not_import_torch():
    code = "import sys, ikgrad.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


# ---------------------------------------------------------------- settings of a training


def test_options_win_over_the_file(written):
    path = written(
        "model: classic\nrobot: panda\nhidden: [5]\nlr: 0.1\ndata: {scheme: cube, count: 10, half_width: 0.03}\n"
    )
    config = train_config(path, {"hidden": [20, 20], "lr": None, "data": {"count": 30}})
    assert config == TrainConfig(
        robot="panda", hidden=(20, 20), data={"scheme": "cube", "count": 30, "half_width": 0.03}
    )
    assert train_config(path, {"data": {"scheme": "helix"}}).data == {"scheme": "helix"}
    assert train_config(path, {"data": "mine.safetensors"}).data == "mine.safetensors"


def test_settings_survive_a_round_trip_through_yaml(written):
    config = TrainConfig(
        robot="arm.urdf",
        tip="0",
        hidden=(20, 10),
        lr=1e-5,
        data={"scheme": "helix", "centre": (0.1, 0.2, 1e-17)},
        optimizer="Adam",
        optimizer_options={"betas": [0.8, 0.99]},
        batch_size=7,
    )
    again = load_config(TrainConfig, written(config.to_yaml()))
    assert again.to_yaml() == config.to_yaml()
    assert again.tip == "0"
    assert again.data["centre"] == [0.1, 0.2, 1e-17]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hiden": [3]}, "options: unknown key 'hiden'; did you mean 'hidden'\\? \\(known: robot, base,"),
        ({"hidden": 20}, "options: key 'hidden' must be of type tuple\\[int, ...\\], got 20"),
        ({"hidden": [2.5]}, "key 'hidden' must be of type tuple"),
        ({"hidden": []}, "hidden must be one or more positive numbers, got \\[\\]"),
        ({"hidden": [20, 0]}, "hidden must be one or more positive numbers, got \\[20, 0\\]"),
        ({"robot": None}, "key 'robot' must be of type str, got None"),
        ({"robot": ""}, "robot must be the name of a built-in robot or the path of a URDF file, got nothing"),
        ({"feedback": "maybe"}, "key 'feedback' must be of type bool, got 'maybe'"),
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"batch_size": 10}, "batch_size must be null: levenberg_marquardt takes all rows at once, got 10"),
        ({"epochs": -1}, "epochs must be at least 1, got -1"),
        ({"members": 0}, "members must be at least 1, got 0"),
        ({"patience": 0}, "patience must be at least 1, got 0"),
        ({"seed": -1}, "seed must be from 0 to 2\\^63 - 1, got -1"),
        ({"lr": 0}, "lr must be positive and finite, got 0"),
        ({"lr": float("nan")}, "lr must be positive and finite, got nan"),
        ({"lr": "fast"}, "key 'lr' must be of type float | None, got 'fast'"),
        ({"loss": "pose"}, "key 'loss' must be of type Literal\\['joint'\\], got 'pose'"),
        ({"dtype": "float16"}, "key 'dtype' must be of type Literal"),
        ({"device": "gpu"}, "device must be cpu, cuda or cuda:N, got 'gpu'"),
        ({"data": 3}, "key 'data' must be of type str | dict"),
        ({"data": {"scheme": "cube"}, "optimizer_options": [1]}, "key 'optimizer_options' must be of type dict"),
    ],
)
def test_wrong_settings_of_a_training_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        train_config({"model": "classic", "robot": "panda"}, options)


def test_keys_of_a_scheme_need_a_scheme(written):
    with pytest.raises(ConfigError, match="key 'data' must name a 'scheme', or change keys of one"):
        train_config({"model": "classic", "robot": "panda", "data": "mine.safetensors"}, {"data": {"count": 3}})
    with pytest.raises(ConfigError, match="data must be the path of a data set or name a 'scheme'"):
        train_config({"model": "classic", "robot": "panda", "data": {"count": 3}}, {})


@pytest.mark.parametrize("cls", [TrainConfig, StreamConfig])
def test_every_key_of_a_training_is_described(cls: type):
    assert list(describe_keys(cls)) == [field.name for field in dataclasses.fields(cls)]


@pytest.mark.parametrize("name", ["denso_closed_loop", "denso_feedback", "denso_traditional"])
def test_built_in_trainings_are_found_by_name(name: str):
    assert load_config(TrainConfig, find_config(name)).robot == "denso_vp6242"


def test_an_unknown_built_in_name_is_refused():
    with pytest.raises(UnknownNameError, match="unknown configuration 'denso_fedback'; did you mean 'denso_feedback'"):
        find_config("denso_fedback")


# ---------------------------------------------------------------- two kinds of trainings


def test_the_model_decides_which_settings_there_are():
    assert train_config(None, {"robot": "panda"}) == StreamConfig(robot="panda")
    assert train_config({"robot": "panda"}, {"model": "increment"}) == StreamConfig(robot="panda", model="increment")
    assert train_config(None, {"robot": "panda", "model": "classic"}) == TrainConfig(robot="panda")
    config = StreamConfig(robot="panda", spread=0.2)
    assert train_config(config, {"seed": 3}) == dataclasses.replace(config, seed=3)


def test_the_configuration_for_any_robot_holds_the_defaults():
    assert train_config(find_config("inverter"), {"robot": "panda"}) == StreamConfig(robot="panda")


def test_settings_of_a_stream_survive_a_round_trip_through_yaml(written):
    config = StreamConfig(robot="arm.urdf", tip="0", model="increment", spread=None, lr=1e-5, steps=9, loss_shape="log")
    text = config.to_yaml()
    assert "spread: null\n" in text
    assert train_config(written(text), {}) == config


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        (
            {},
            {"hidden": [3]},
            "options: key 'hidden' belongs to model classic, but model is unrolled; leave it out, or",
        ),
        ({}, {"patience": 3}, "options: key 'patience' belongs to model classic, .* or say 'model: classic'"),
        (
            {"model": "classic"},
            {"minutes": 3},
            "'minutes' belongs to the models unrolled and increment, but model is classic; .*'model: unrolled'",
        ),
        ({"epochs": 3}, {}, "settings: key 'epochs' belongs to model classic, but model is unrolled"),
        (TrainConfig(robot="panda"), {"model": "increment"}, "settings: key 'feedback' belongs to model classic"),
        (
            {},
            {"model": "unroled"},
            "options: key 'model' must be unrolled, increment or classic, got 'unroled'; did you",
        ),
        ({"model": 3}, {}, "settings: key 'model' must be unrolled, increment or classic, got 3$"),
        ({}, {"model": "increment", "rounds": 3}, "rounds belongs to model unrolled, got 3"),
        (
            {},
            {"minuts": 3},
            "options: unknown key 'minuts'; did you mean 'minutes'\\? \\(known: robot, base, tip, model,",
        ),
        ({}, {"minutes": 0}, "minutes must be positive and finite, got 0"),
        ({}, {"minutes": float("inf")}, "minutes must be positive and finite, got inf"),
        ({}, {"lr": float("nan")}, "lr must be positive and finite, got nan"),
        ({}, {"spread": -0.1}, "spread must be positive and finite, got -0.1"),
        ({}, {"steps": 0}, "steps must be at least 1, got 0"),
        ({}, {"steps": 1.5}, "key 'steps' must be of type int | None, got 1.5"),
        ({}, {"width": 0}, "width must be at least 1, got 0"),
        ({}, {"width": True}, "key 'width' must be of type int | None, got True"),
        ({}, {"batch_size": None}, "key 'batch_size' must be of type int, got None"),
        ({}, {"seed": 2**30 - 1}, "seed must be from 0 to 2\\^30 - 2, got 1073741823"),
        ({}, {"joint_weight": -1}, "joint_weight must be a finite weight, 0 or more, got -1"),
        ({}, {"pose_weight": 0}, "pose_weight and joint_weight must not both be 0: there is nothing to learn, got 0"),
        ({}, {"labels": "solved"}, "key 'labels' must be of type Literal\\['made', 'solver'\\], got 'solved'"),
        ({}, {"device": "gpu"}, "device must be cpu, cuda or cuda:N, got 'gpu'"),
    ],
)
def test_wrong_settings_of_a_stream_are_refused(source, options, message):
    if isinstance(source, dict):
        source = {"robot": "panda", **source}
    with pytest.raises(ConfigError, match=message):
        train_config(source, options)


@pytest.mark.parametrize("name", ["denso_closed_loop", "denso_feedback", "denso_traditional", "inverter"])
def test_shipped_settings_of_a_training_can_be_used(name: str):
    options = {} if name.startswith("denso") else {"robot": "panda"}
    assert train_config(builtin_file("configs", name), options).robot in ("denso_vp6242", "panda")
