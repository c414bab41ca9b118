"""The paths of the studies by name."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.cli.view import STUDIES
from ikgrad.papers.printed import numbers, read_table
from ikgrad.view.paths import PATHS, find_path, named_motion


def test_the_command_knows_all_paths():
    assert tuple(PATHS) == STUDIES


@pytest.mark.parametrize("name", PATHS)
def test_a_path_is_finite_without_leaps_and_of_its_robot(name: str):
    robot = ik.load_robot(find_path(name).robot)
    motion = named_motion(name, robot)
    assert motion.q.shape[1] == robot.dof
    assert bool(motion.q.isfinite().all())
    steps = ik.forward_kinematics(robot, motion.q)[:, :3, 3].diff(dim=0).norm(dim=-1)
    assert float(steps.max()) < 0.1 * robot.length
    assert motion.name.startswith(name)


def test_the_apps_path_ends_every_motion_where_table_3_says():
    """R_1 of the seven motions are iterates of the path, to the 0.01 deg that R_2 keeps of them."""
    q = named_motion("apps", ik.load_robot("kr210")).q.rad2deg()
    columns = [f"theta{k}_deg" for k in range(1, 7)]
    for row in read_table("apps_table3"):
        if row["quantity"] == "R_1":
            off = (q - torch.tensor(numbers(row, *columns), dtype=torch.float64) + 180) % 360 - 180
            assert float(off.abs().amax(dim=-1).min()) < 0.005


def test_the_trajectory_meets_its_obstacle_on_one_way_only():
    from ikgrad.collision import link_segments

    robot, spheres = ik.load_robot("arm4"), find_path("trajectory").spheres()
    least = []
    for name in ("trajectory", "trajectory-2"):
        segments = link_segments(robot, named_motion(name, robot).q)
        least.append(float(ik.sphere_link_distance(segments, spheres.centers, spheres.radii).min()))
    assert least[0] < 0 < least[1]


def test_another_robot_and_another_name_are_mistakes():
    with pytest.raises(ik.ConfigError, match="the path 'apps' is of the built-in robot 'kr210', not of 'panda'"):
        named_motion("apps", ik.load_robot("panda"))
    with pytest.raises(ik.ConfigError, match="leave --robot, --base and --tip out"):
        named_motion("apps", ik.load_robot("kr210", tip="link_5"))
    with pytest.raises(ik.UnknownNameError, match="did you mean 'puma'"):
        find_path("pumaa")
