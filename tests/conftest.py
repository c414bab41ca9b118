"""Shared fixtures: every built-in robot, and one made-up chain with everything that a URDF may contain."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # before torch: two workers on two cores must not spin

from pathlib import Path

import pytest
import torch
from support import BUILTIN, ZOO

import ikgrad as ik

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def zoo_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("zoo") / "zoo.urdf"
    path.write_text(ZOO)
    return path


@pytest.fixture(params=[*BUILTIN, "zoo"])
def robot(request: pytest.FixtureRequest, zoo_path: Path) -> ik.Robot:
    """Every built-in robot and the zoo, from its root to the hand."""
    return ik.load_robot(zoo_path, tip="hand") if request.param == "zoo" else ik.load_robot(request.param)


@pytest.fixture
def panda() -> ik.Robot:
    return ik.load_robot("panda")
