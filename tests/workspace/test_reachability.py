"""`reachability` against closed forms, against the full solver, and against itself."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.errors import ConfigError, ShapeError
from ikgrad.workspace import Survey, even_rotations, search

POSITION = (1, 1, 1, 0, 0, 0)
GANTRY = """<robot name="gantry">{links}{joints}</robot>"""


def elbow_arm(low: float, high: float) -> ik.Robot:
    """A vertical axis, a shoulder and an elbow, links of 0.7 m and 0.4 m: a shell of a ball is its reach."""
    rows = [(0.0, 0.0, 0.0, math.pi / 2), (0.0, 0.0, 0.7, 0.0), (0.0, 0.0, 0.4, 0.0)]
    turn = math.pi
    return ik.Robot.from_dh(rows, convention="standard", q_min=[-turn, -turn, low], q_max=[turn, turn, high])


def gantry(folder: Path) -> ik.Robot:
    """Three slides: a box is its reach."""
    links = "".join(f'<link name="{name}"/>' for name in "abcd")
    joints = "".join(
        f'<joint name="{axis}" type="prismatic"><parent link="{before}"/><child link="{after}"/>'
        f'<axis xyz="{xyz}"/><limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>'
        for axis, before, after, xyz, low, high in (
            ("x", "a", "b", "1 0 0", -0.42, 0.22),
            ("y", "b", "c", "0 1 0", 0.08, 0.52),
            ("z", "c", "d", "0 0 1", -0.12, 0.12),
        )
    )
    path = folder / "gantry.urdf"
    path.write_text(GANTRY.format(links=links, joints=joints))
    return ik.load_robot(path)


@pytest.mark.parametrize(("low", "high"), [(-math.pi, math.pi), (0.6, 2.4)])
def test_an_elbow_reaches_a_shell(low: float, high: float):
    found = ik.reachability(elbow_arm(low, high), cell=0.1, mask=POSITION)
    bend = np.clip(np.array([max(abs(low), high), min(abs(low), high) if low > 0 else 0.0]), 0, math.pi)
    least, most = np.sqrt(0.7**2 + 0.4**2 + 2 * 0.7 * 0.4 * np.cos(bend))
    distance = found.centres.norm(dim=-1)
    wanted = (distance >= least - 1e-9) & (distance <= most + 1e-9)
    assert torch.equal(found.share == 1, wanted)
    assert torch.equal(found.unreachable == 1, ~wanted)  # here the bounds are sharp
    assert found.volume == pytest.approx(int(wanted.sum()) * 0.1**3)
    assert len(found.orientations) == 1  # the orientation does not matter


def test_slides_reach_a_box_and_move_alike_in_it(tmp_path: Path):
    robot = gantry(tmp_path)
    found = ik.reachability(robot, cell=0.1, mask=POSITION)
    wanted = ((found.centres >= robot.q_min) & (found.centres <= robot.q_max)).all(dim=-1)
    assert torch.equal(found.share == 1, wanted)
    assert (found.q[wanted] - found.centres[wanted]).abs().max() < 2e-6
    assert (found.condition[wanted] - 1).abs().max() < 1e-12
    assert bool(found.condition[~wanted].isinf().all())
    assert bool(found.q[~wanted].isnan().all())


def test_a_turn_about_the_first_axis_turns_the_map():
    found = ik.reachability(elbow_arm(0.6, 2.4), cell=0.15, mask=POSITION)
    share = {tuple(x): s for x, s in zip(found.centres.mul(1 / 0.15).round().int().tolist(), found.share, strict=True)}
    assert all(share[x, y, z] == share[-y, x, z] for x, y, z in share)


@pytest.fixture(scope="module")
def coarse() -> ik.WorkspaceMap:
    return ik.reachability(ik.load_robot("panda"), cell=0.12, orientations=7, seed=3)


def poses_of(found: ik.WorkspaceMap) -> Tensor:
    T = torch.eye(4, dtype=torch.float64).repeat(len(found.centres), len(found.orientations), 1, 1)
    T[..., :3, :3], T[..., :3, 3] = found.orientations, found.centres[:, None]
    return T


def test_the_joints_of_a_cell_are_what_the_map_says(coarse: ik.WorkspaceMap):
    robot, some = coarse.robot, coarse.orientation >= 0
    assert torch.equal(some, coarse.share > 0)
    q, T = coarse.q[some], ik.forward_kinematics(coarse.robot, coarse.q[some])
    assert (T[:, :3, 3] - coarse.centres[some]).norm(dim=-1).max() <= 1e-6
    assert (T[:, :3, :3] - coarse.orientations[coarse.orientation[some]]).abs().max() <= 1e-6
    assert bool(((q >= robot.q_min) & (q <= robot.q_max)).all())
    J = ik.jacobian(robot, q)
    J[:, :3] /= robot.typical_length
    s = torch.linalg.svdvals(J)
    assert torch.allclose(coarse.condition[some], s[:, 0] / s[:, -1], rtol=1e-9, atol=0)
    assert bool((coarse.manipulability[some] >= s.prod(dim=-1) * (1 - 1e-9)).all())


def test_the_full_solver_reaches_no_more(coarse: ik.WorkspaceMap):
    whole = ik.solve_ik(coarse.robot, poses_of(coarse), seed=99).success.double().mean(dim=1)
    assert (whole - coarse.share).abs().mean() < 1e-3
    assert bool((whole <= 1 - coarse.unreachable + 1e-12).all())


def test_neighbours_find_what_one_start_misses(coarse: ik.WorkspaceMap, monkeypatch: pytest.MonkeyPatch):
    options = dict(cell=0.06, orientations=even_rotations(20)[11:12], starts=1)
    helped = ik.reachability(coarse.robot, **options)
    monkeypatch.setattr(search, "flood", lambda *_: 0)
    alone = ik.reachability(coarse.robot, **options)
    many = ik.reachability(coarse.robot, **{**options, "starts": 64})
    assert alone.reached < 0.92 * many.reached
    assert helped.reached > 0.99 * many.reached
    assert bool((helped.share >= alone.share).all())


def test_threads_and_steps_change_no_bit(coarse: ik.WorkspaceMap):
    torch.set_num_threads(2)
    try:
        survey = Survey(coarse.robot, cell=0.12, orientations=7, seed=3)
        for _ in range(3):
            survey.step()
        kept = survey.state()
        again = Survey(coarse.robot, cell=0.12, orientations=7, seed=3)
        again.restore(kept)
        while not again.finished:
            again.step()
    finally:
        torch.set_num_threads(1)
    for name, column in again.result().columns().items():
        assert np.array_equal(column, coarse.columns()[name], equal_nan=True), name


def test_solutions_are_counted_as_the_closed_form_does():
    robot = ik.load_robot("puma560")
    found = ik.reachability(robot, cell=0.3, orientations=3, solutions=150)
    valid = ik.puma560_ik(poses_of(found)).valid
    count = valid.sum(dim=-1)  # (C, O)
    reached = (count > 0).sum(dim=-1)
    assert torch.equal(found.share, reached.double() / 3)
    mean = torch.where(reached > 0, count.sum(dim=-1) / reached.clamp(min=1), 0.0)
    assert found.solutions_mean is not None
    assert found.solutions_most is not None
    assert (found.solutions_mean - mean).abs().mean() < 0.02
    assert bool((found.solutions_most <= count.amax(dim=-1)).all())
    assert int(found.solutions_most.max()) == int(count.max())


def test_watch_hears_of_every_orientation():
    heard: list[tuple[int, int]] = []
    ik.reachability(ik.load_robot("ur5e"), cell=0.5, orientations=3, watch=lambda done, of: heard.append((done, of)))
    assert heard == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(("name", "limited"), [("panda", True), ("ur5e", False)])
def test_a_turn_left_free_helps_where_the_last_joint_is_limited(name: str, limited: bool):
    robot = ik.load_robot(name)
    full = ik.reachability(robot, cell=0.2, orientations=5)
    free = ik.reachability(robot, cell=0.2, orientations=5, mask=(1, 1, 1, 1, 1, 0))
    assert bool((free.share >= full.share).all())
    assert (free.reached > full.reached) == limited


REFUSED = {
    "fewer joints": (
        "arm4", {}, "robot 'arm4' has 4 joints, too few for poses with 6 directions; give a mask with fewer"
    ),
    "endlessly many": ("panda", {"solutions": 4}, "7 joints for 6 directions and so endlessly many solutions"),
    "negative": ("ur5e", {"solutions": -1}, "solutions must not be negative, got -1"),
    "mask": ("ur5e", {"mask": (1, 1, 1)}, "mask must hold six zeros or ones"),
    "no position": ("ur5e", {"mask": (1, 1, 0, 1, 1, 1)}, "the first three of mask must be 1"),
    "cell": ("ur5e", {"cell": 0.0}, "cell must be positive, got 0.0"),
    "nan": ("ur5e", {"cell": math.nan}, "cell must be positive, got nan"),
    "starts": ("ur5e", {"starts": 0}, "starts must be positive, got 0"),
    "none": ("ur5e", {"orientations": 0}, "orientations must be at least 1, got 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_are_refused(case: str):
    name, options, message = REFUSED[case]
    with pytest.raises(ConfigError, match=message):
        Survey(ik.load_robot(name), **options)


@pytest.mark.parametrize(
    ("R", "message"),
    [
        (torch.eye(4)[None], r"orientations must be a number or have shape \(O, 3, 3\), got \(1, 4, 4\)"),
        (torch.stack([torch.eye(3), -torch.eye(3)]), r"orientations\[1\] is no rotation"),
        (torch.full((1, 3, 3), math.nan), r"orientations\[0\] is no rotation: \|R R\^T - 1\| is inf"),
    ],
)
def test_what_is_no_rotation_is_refused(R: Tensor, message: str):
    with pytest.raises(ShapeError, match=message):
        Survey(ik.load_robot("ur5e"), orientations=R)


def test_a_slide_without_limits_is_refused():
    rows = [{"kind": "prismatic", "theta": 0.0, "a": 0.0, "alpha": 0.0}] * 3
    robot = ik.Robot.from_dh(rows, convention="standard", name="rail")
    with pytest.raises(ConfigError, match="robot 'rail' has a slide without limits, so its reach has no end"):
        Survey(robot, mask=POSITION)
