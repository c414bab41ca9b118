"""Configurations: typed, strict, and refused with the file and the key."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest

from ikgrad.config import AppsConfig, load_config
from ikgrad.errors import ConfigError
from ikgrad.resources import builtin_file


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
