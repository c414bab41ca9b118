"""No configuration leaves the bounds, and on simple arms they are reached."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.workspace import reach


def distances(robot: ik.Robot, shoulder: torch.Tensor, count: int = 20_000) -> tuple[torch.Tensor, torch.Tensor]:
    T = ik.forward_kinematics(robot, ik.sample_configurations(robot, count, seed=0))
    wrist = T @ torch.linalg.inv(robot.tables().tool)
    return (T[:, :3, 3] - shoulder).norm(dim=-1), (wrist[:, :3, 3] - shoulder).norm(dim=-1)


def test_no_configuration_leaves_them(robot: ik.Robot):
    bounds = reach(robot)
    tip, wrist = distances(robot, torch.from_numpy(bounds.shoulder))
    for found, span in ((tip, bounds.tip), (wrist, bounds.wrist)):
        assert span.least - 1e-12 <= found.min() <= found.max() <= span.most + 1e-12
    assert bounds.tip.most <= robot.reach_bound + 1e-12


@pytest.mark.parametrize(("name", "close"), [("panda", 2e-3), ("iiwa14", 2e-3), ("ur5e", 2e-3), ("puma560", 1e-4)])
def test_they_are_nearly_attained(name: str, close: float):
    robot = ik.load_robot(name)
    bounds = reach(robot)
    tip, wrist = distances(robot, torch.from_numpy(bounds.shoulder), 100_000)
    assert tip.max() > bounds.tip.most - close * robot.length
    assert wrist.max() > bounds.wrist.most - close * robot.length


@pytest.mark.parametrize(("low", "high"), [(-math.pi, math.pi), (0.5, 2.0), (-2.5, -0.1), (2.0, 4.0)])
def test_two_links_obey_the_law_of_cosines(low: float, high: float):
    robot = ik.Robot.from_dh(
        [(0.0, 0.0, 0.7, 0.0), (0.0, 0.0, 0.4, 0.0)], convention="standard", q_min=[-3, low], q_max=[3, high]
    )
    q = torch.linspace(low, high, 100_001, dtype=torch.float64)
    d = (0.7**2 + 0.4**2 + 2 * 0.7 * 0.4 * q.cos()).sqrt()
    assert tuple(reach(robot).tip) == pytest.approx((float(d.min()), float(d.max())), abs=1e-9)


SLIDES = """<robot name="gantry"><link name="a"/><link name="b"/><link name="c"/>
  <joint name="j1" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
    <limit lower="-0.2" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="j2" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0.1" upper="0.2" effort="1" velocity="1"/></joint></robot>"""


def test_slides_in_a_row(tmp_path: Path):
    path = tmp_path / "gantry.urdf"
    path.write_text(SLIDES)
    bounds = reach(ik.load_robot(path))
    assert bounds.tip.most == pytest.approx(1.0)
    assert bounds.tip.least <= 0.4
    assert bounds.wrist == (0.0, math.inf)  # a slide carries the last frame away from its place
