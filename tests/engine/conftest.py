"""Robots that the engine's tests run over: the built-in ones and chains made to be awkward."""

import math

import pytest

from ikgrad.resources import builtin_names
from ikgrad.robot import Robot, load_robot

AWKWARD_URDF = """
<robot name="awkward">
  <link name="world"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/><link name="f"/>
  <link name="g"/><link name="tip"/>
  <joint name="j1" type="continuous"><parent link="world"/><child link="a"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.3 -0.2 0.1"/><axis xyz="1 2 3"/></joint>
  <joint name="j2" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0.2 0.1 0.3" rpy="1.3 0.2 -0.1"/><axis xyz="0 -1 0"/>
    <limit lower="-2.2" upper="2.4" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="b"/><child link="c"/>
    <origin xyz="0 0.1 0.1" rpy="0.2 0.7 -0.6"/><axis xyz="1 0 -1"/>
    <limit lower="-0.2" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="j3" type="revolute"><parent link="c"/><child link="d"/>
    <origin xyz="0.25 0 0" rpy="0 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="-2.8" upper="2.8" effort="1" velocity="1"/></joint>
  <joint name="follower" type="revolute"><parent link="d"/><child link="e"/>
    <origin xyz="0.2 0 0.05" rpy="0.5 0 0"/><axis xyz="0 1 1"/>
    <limit lower="-2.8" upper="2.8" effort="1" velocity="1"/><mimic joint="j2" multiplier="-0.5" offset="0.3"/></joint>
  <joint name="j4" type="revolute"><parent link="e"/><child link="f"/>
    <origin xyz="0 0 0.2" rpy="0 1.5707963 0"/><axis xyz="1 0 0"/>
    <limit lower="-2.8" upper="2.8" effort="1" velocity="1"/></joint>
  <joint name="j5" type="revolute"><parent link="f"/><child link="g"/>
    <origin xyz="0.05 0 0.1" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.8" upper="2.8" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><parent link="g"/><child link="tip"/>
    <origin xyz="0.03 0.02 0.1" rpy="0.1 0.2 0.3"/></joint>
</robot>
"""


def _snake(count: int) -> Robot:
    """Many short links whose axes alternate."""
    rows = [{"theta": 0.1, "d": 0.02, "a": 0.1, "alpha": (-1) ** k * math.pi / 2} for k in range(count)]
    return Robot.from_dh(rows, convention="standard", q_min=[-1.5] * count, q_max=[1.5] * count, name="snake")


def _nearly_parallel() -> Robot:
    """Axes that differ by 1e-9 and by 1e-13: Denavit-Hartenberg parameters would explode."""
    rows = [{"theta": 0.0, "d": 0.1, "a": 0.3, "alpha": alpha} for alpha in (1e-9, 1e-13, 1.2, 0.0, math.pi, 1.0)]
    return Robot.from_dh(rows, convention="modified", q_min=[-3] * 6, q_max=[3] * 6, name="nearly_parallel")


BUILT_IN = builtin_names("urdf")


def _robot_named(name: str, folder) -> Robot:
    if name == "awkward":
        path = folder / "awkward.urdf"
        path.write_text(AWKWARD_URDF)
        return load_robot(path)
    made = {"snake": lambda: _snake(31), "one": lambda: _snake(1), "nearly_parallel": _nearly_parallel}
    return made[name]() if name in made else load_robot(name)


@pytest.fixture(scope="session", params=[*BUILT_IN, "awkward", "snake", "one", "nearly_parallel"])
def robot(request, tmp_path_factory):
    return _robot_named(request.param, tmp_path_factory.mktemp("robots"))


@pytest.fixture(scope="session", params=[*BUILT_IN, "awkward", "snake"])
def solvable(request, tmp_path_factory):
    """Robots whose random poses the solver must reach without fail."""
    return _robot_named(request.param, tmp_path_factory.mktemp("robots"))


@pytest.fixture(scope="session")
def panda():
    return load_robot("panda")
