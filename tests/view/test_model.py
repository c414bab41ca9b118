"""What the page shows, without a page: shapes, answers in words, races, motions, clearance, the worker."""

from __future__ import annotations

import itertools
import logging
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.collision import Spheres
from ikgrad.solvers.damped import typical_length
from ikgrad.view import Motion, Part, Run, Session, arm_parts, race, read_motion
from ikgrad.view.motion import thinned
from ikgrad.view.obstacles import clearance
from ikgrad.view.race import INVERTER, curves, inverter_for, iterations_to_show
from ikgrad.view.session import comfortable
from ikgrad.view.shapes import base_mesh, link_radius, part_mesh, segments
from ikgrad.view.worker import Worker

# ---------------------------------------------------------------- shapes


def test_the_surface_of_a_part_lies_around_its_axis_and_looks_outwards(robot: ik.Robot):
    for part in arm_parts(robot):
        mesh = part_mesh(part)
        scale = part.radius + np.abs(mesh.vertices).max()
        far = from_axis(mesh.vertices.astype(np.float64), part)
        distance = np.linalg.norm(far, axis=1)
        assert distance.max() <= part.radius * (1 + 1e-3) + 1e-6 * scale
        corners = mesh.vertices.astype(np.float64)[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middles = corners.mean(axis=1)
        if part.role == "link":  # round everywhere; ends of the balls lie inside the tube and look where they may
            shown = np.linalg.norm(from_axis(middles, part), axis=1) > 0.9 * part.radius
            assert shown.any()
            assert ((normals * from_axis(middles, part)).sum(axis=1)[shown] > 0).all()
        else:  # a cylinder is convex: its faces look away from its middle
            assert ((normals * (middles - (part.start + part.end) / 2)).sum(axis=1) > 0).all()


def from_axis(points: np.ndarray, part: Part) -> np.ndarray:
    """(P, 3) vectors from the nearest points of the part's axis."""
    d = part.end - part.start
    t = ((points - part.start) @ d / (d @ d)).clip(0, 1)
    return points - part.start - t[:, None] * d


def test_the_foot_stands_on_the_floor_and_is_closed():
    mesh = base_mesh(0.05)
    a, b, c = mesh.vertices.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
    assert (a * np.cross(b, c)).sum() > 0  # signed volume: the faces look outwards
    assert mesh.vertices[:, 2].min() > -1e-4


def test_the_links_join_the_joints_in_every_pose(robot: ik.Robot):
    """A capsule ends where the axis of the next joint passes: the arm has no gap, whatever its joints are."""
    q = ik.sample_configurations(robot, 5, seed=0)
    parts = arm_parts(robot)
    for row in q:
        ends = segments(parts, ik.link_poses(robot, row))
        solids = [ends[k] for k, part in enumerate(parts) if part.role != "joint"]
        centres = [ends[k].mean(dim=0) for k, part in enumerate(parts) if part.role == "joint"]
        for centre in centres:
            gaps = [distance_to_segment(centre, solid) for solid in solids]
            assert min(gaps) < 1e-9


def distance_to_segment(point: torch.Tensor, ends: torch.Tensor) -> float:
    d = ends[1] - ends[0]
    t = ((point - ends[0]) @ d / (d @ d)).clamp(0, 1)
    return float((point - ends[0] - t * d).norm())


def test_a_joint_lies_along_its_axis_and_does_not_turn_away(panda: ik.Robot):
    parts = [part for part in arm_parts(panda) if part.role == "joint"]
    q = torch.full((7,), -0.5, dtype=torch.float64)
    along = segments(tuple(parts), ik.link_poses(panda, q)).diff(dim=1)[:, 0]
    J = ik.jacobian(panda, q)
    assert torch.allclose(along / along.norm(dim=1, keepdim=True), J[3:].T)


def test_a_slide_runs_on_a_rail_as_long_as_its_range(zoo_path: Path):
    robot = ik.load_robot(zoo_path, tip="hand")
    (rail,) = [part for part in arm_parts(robot) if part.role == "rail"]
    assert np.linalg.norm(rail.end - rail.start) == pytest.approx(0.6)


def test_an_endless_slide_has_a_rail_that_ends():
    robot = ik.Robot.from_dh(
        [{"kind": "prismatic", "alpha": 0.3}, {"a": 0.4}], convention="standard", name="rail and arm"
    )
    (rail,) = [part for part in arm_parts(robot) if part.role == "rail"]
    assert np.linalg.norm(rail.end - rail.start) == pytest.approx(1.0)


# ---------------------------------------------------------------- answers


def test_the_first_pose_is_inside_the_limits_above_the_floor_and_not_singular(robot: ik.Robot):
    q = comfortable(robot)
    assert bool(((q >= robot.q_min) & (q <= robot.q_max)).all())
    assert float(torch.linalg.svdvals(ik.jacobian(robot, q)).min()) > 1e-3
    assert torch.equal(q, comfortable(robot))


def test_a_target_nearby_is_reached_without_a_leap(panda: ik.Robot):
    session = Session(panda)
    q = session.home + 0.02
    answer = session.reach(ik.forward_kinematics(panda, q))
    assert (answer.success, answer.reason, answer.words) == (True, "converged", "reached")
    assert float((answer.q - session.home).abs().max()) < 0.2
    assert torch.equal(session.q, answer.q)


@pytest.mark.parametrize("thorough", [True, False])
def test_a_target_too_far_is_explained_and_approached(panda: ik.Robot, thorough: bool):
    session = Session(panda)
    T = session.T_target.clone()
    T[:3, 3] *= 20
    before = float((T[:3, 3] - session.T_target[:3, 3]).norm())
    answer = session.reach(T, thorough=thorough)
    assert not answer.success
    assert answer.words.startswith("out of reach: the target is ")
    assert "m from the first joint" in answer.words
    assert "wrist" not in answer.words
    assert answer.position_error < before
    assert bool(((answer.q >= panda.q_min) & (answer.q <= panda.q_max)).all())
    measured = ik.forward_kinematics(panda, session.q)
    assert answer.position_error == pytest.approx(float((T[:3, 3] - measured[:3, 3]).norm()))
    assert f"missing {1e3 * answer.position_error:.1f} mm" in answer.words


@pytest.mark.parametrize("position_only", [True, False])
def test_an_arm_comes_as_near_to_a_far_target_as_it_can(panda: ik.Robot, position_only: bool):
    """Stretched out towards it, to within a tenth of the arm's length."""
    session = Session(panda, position_only=position_only)
    T = session.T_target.clone()
    T[:3, 3] = torch.tensor([3.0, 2.0, 0.333])
    answer = session.reach(T)
    reached = ik.forward_kinematics(panda, answer.q)[:3, 3]
    direction = T[:3, 3] / T[:3, 3].norm()
    assert float(reached @ direction) > 0.8
    later = session.reach(T)
    weigh = (
        typical_length(panda) ** -2 * later.position_error**2,
        typical_length(panda) ** -2 * answer.position_error**2,
    )
    turned = (0.0, 0.0) if position_only else (later.rotation_error**2, answer.rotation_error**2)
    assert weigh[0] + turned[0] <= (weigh[1] + turned[1]) * (1 + 1e-12)


def test_joint_limits_are_named(panda: ik.Robot):
    q = panda.q_max.clone()
    q[3] = 1.0  # an elbow that bends the other way
    q[:3] *= 0.1
    q[4:] *= 0.1
    answer = Session(panda).reach(ik.forward_kinematics(panda, q))
    assert answer.success or answer.words.startswith("joint limits: ")
    one = ik.Robot.from_dh([{"a": 1.0}], convention="standard", q_min=[-1.0], q_max=[1.0], name="hand of a clock")
    session = Session(one, position_only=False)
    answer = session.reach(ik.forward_kinematics(one, torch.tensor([2.0]).double()))
    assert answer.reason == "joint_limits"
    assert answer.words.startswith("joint limits: the arm could be there only with a joint outside its limits")


def test_an_orientation_out_of_reach_blames_the_wrist():
    robot = ik.load_robot("ur5e")
    session = Session(robot)
    T = torch.eye(4, dtype=torch.float64)
    T[:3, 3] = torch.tensor([0.0, 0.0, robot.reach_bound])  # the tool turned back: the wrist would be beyond
    T[:3, :3] = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    assert "with this orientation the wrist is too far away" in session.reach(T).words


def test_an_invalid_target_leaves_the_arm_where_it_is(panda: ik.Robot):
    session = Session(panda)
    answer = session.reach(torch.full((4, 4), torch.nan, dtype=torch.float64))
    assert answer.words == "the target is no rigid transform"
    assert torch.equal(session.q, session.home)


def test_arms_with_few_joints_are_asked_for_a_position_only():
    robot = ik.load_robot("arm4")
    session = Session(robot)
    T = ik.forward_kinematics(robot, session.home - 0.3)
    T[:3, :3] = torch.eye(3)
    assert session.reach(T).success
    session.ask_orientation(True)
    answer = session.reach(T)
    assert answer.reason == "no_convergence"
    assert "deg" in answer.words


def test_solutions_are_different_and_all_reach_the_target():
    robot = ik.load_robot("ur5e")
    session = Session(robot)
    found = session.solutions()
    assert len(found) >= 4
    assert torch.allclose(found[0], session.q, atol=1e-4)  # nearest first
    assert torch.allclose(ik.forward_kinematics(robot, found), session.T_target.expand(len(found), 4, 4), atol=1e-5)
    assert float(torch.pdist(found).min()) > 1e-3
    session.T_target = session.T_target.clone()
    session.T_target[:3, 3] *= 20
    assert session.solutions().shape == (0, 6)


def test_reset_goes_back_to_the_first_pose(panda: ik.Robot):
    q = torch.tensor([0.1, -0.3, 0.0, -2.0, 0.0, 2.0, 0.5]).double()
    session = Session(panda, q=q)
    session.move_joints(q + 0.1)
    session.reset()
    assert torch.equal(session.q, q)
    assert torch.equal(session.T_target, ik.forward_kinematics(panda, q))


def test_a_first_pose_outside_the_limits_is_refused(panda: ik.Robot):
    with pytest.raises(ik.ConfigError, match="inside the joint limits"):
        Session(panda, q=torch.full((7,), 9.0).double())
    with pytest.raises(ik.ShapeError, match=r"\.\.\., 7"):
        Session(panda, q=torch.zeros(6).double())


# ---------------------------------------------------------------- races


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """Every method from the first pose of a Panda to a target nearby."""
    robot = ik.load_robot("panda")
    home = comfortable(robot)
    return race(robot, ik.forward_kinematics(robot, home + 0.15), home, inverter=inverter_for(robot))


def test_every_iterate_of_a_race_has_the_error_that_it_shows(panda: ik.Robot, runs: list[Run]):
    home = comfortable(panda)
    T = ik.forward_kinematics(panda, home + 0.15)
    assert [run.name for run in runs] == ["APPS", "Newton-Raphson", "Levenberg-Marquardt", INVERTER]
    for run in runs:
        assert torch.equal(run.q[0], home)
        e = ik.pose_error(ik.forward_kinematics(panda, run.q), T)
        assert torch.allclose(e[:, :3].norm(dim=1), run.position_error, atol=1e-9)
        assert torch.allclose(e[:, 3:].norm(dim=1), run.rotation_error, atol=1e-7)
        assert run.words.startswith("reached in") == run.met
    apps, newton, damped, neural = runs
    assert newton.met
    assert damped.met
    assert len(newton.q) < len(apps.q)
    assert float(neural.position_error[-1]) < 0.1 * float(neural.position_error[0])


def test_a_race_to_a_target_out_of_reach_ends_with_what_is_left():
    robot = ik.load_robot("ur5e")
    session = Session(robot)
    T = session.T_target.clone()
    T[:3, 3] *= 20
    runs = race(robot, T, session.home)
    assert all(run.words.startswith("nearest ") and "ended after" in run.words for run in runs)
    damped = runs[2]
    assert float(damped.position_error[-1]) <= float(damped.position_error[0])  # no new start at the end


def test_an_inverter_does_not_run_where_only_the_position_counts(panda: ik.Robot):
    session = Session(panda, position_only=True)
    runs = race(panda, session.T_target, session.home, mask=session.mask, inverter=inverter_for(panda))
    assert INVERTER not in [run.name for run in runs]


def test_a_classic_inverter_runs_with_its_one_answer():
    robot = ik.load_robot("ur5e")
    q = ik.sample_configurations(robot, 20, seed=0)
    T = ik.forward_kinematics(robot, q)
    for feedback in (False, True):
        inverter = ik.Inverter(robot, feedback=feedback).fit(T, q, q if feedback else None)
        runs = race(robot, T[0], q[1], inverter=inverter)
        assert len(runs[-1].q) == 2


def test_only_the_very_robot_has_its_ready_made_inverter(panda: ik.Robot):
    assert inverter_for(panda) is not None
    assert inverter_for(panda.with_tool(torch.eye(4))) is None
    assert inverter_for(ik.load_robot("kr210", tip="link_5")) is None


def test_iterations_to_show_begin_one_by_one_and_end_at_the_end(runs: list[Run]):
    shown, last = iterations_to_show(runs), max(len(run.q) for run in runs) - 1
    assert shown[:10] == list(range(10))
    assert shown[-1] == last
    assert all(a < b for a, b in itertools.pairwise(shown))
    assert len(shown) < 160


def test_a_race_that_is_won_at_the_start_has_one_picture(panda: ik.Robot):
    session = Session(panda)
    runs = race(panda, session.T_target, session.home)
    assert iterations_to_show(runs) == [0]
    assert all(run.words == "reached in 0 steps" for run in runs)


def test_curves_keep_the_last_error_and_can_be_drawn_on_a_logarithmic_axis(runs: list[Run]):
    steps, errors = curves(runs)
    assert steps[0] == 1
    assert errors.shape == (4, len(steps))
    assert bool((errors > 0).all())
    assert errors[1, -1] == runs[1].position_error[-1].clamp(min=1e-12)


# ---------------------------------------------------------------- motions and obstacles


def test_a_motion_is_the_file_without_rows_that_are_not_finite(panda: ik.Robot, tmp_path: Path):
    q = ik.sample_configurations(panda, 6, seed=0).numpy()
    q[2, 3] = np.nan
    np.save(tmp_path / "q.npy", q)
    motion = read_motion(tmp_path / "q.npy", panda)
    assert (motion.name, motion.skipped, len(motion.q)) == ("q.npy", 1, 5)
    assert np.array_equal(motion.q.numpy(), np.delete(q, 2, axis=0))
    path = motion.tool_path(panda, points=3)
    assert torch.equal(path[[0, -1]], ik.forward_kinematics(panda, motion.q[[0, -1]])[:, :3, 3])
    np.save(tmp_path / "nothing.npy", np.full((2, 7), np.inf))
    with pytest.raises(ik.DataError, match="no row has finite joints"):
        read_motion(tmp_path / "nothing.npy", panda)


def test_thinning_keeps_the_ends():
    assert thinned(1, 5).tolist() == [0]
    rows = thinned(100_000, 900)
    assert (len(rows), int(rows[0]), int(rows[-1])) == (900, 0, 99_999)


def test_clearance_is_the_distance_between_what_is_drawn():
    robot = ik.load_robot("ur5e")
    parts, q = arm_parts(robot), torch.zeros(6, dtype=torch.float64)
    poses = ik.link_poses(robot, q)
    tip = poses[-1, :3, 3]
    outwards = tip / tip.norm()
    centres = torch.stack([tip + 5 * outwards, tip + 0.5 * outwards])
    found = clearance(parts, poses, Spheres(centres, torch.tensor([0.1, 0.1]).double()))
    axes = segments(parts, poses)
    least = min(distance_to_segment(centres[1], axis) - part.radius for axis, part in zip(axes, parts, strict=True))
    assert found.distance == pytest.approx(least - 0.1)
    assert found.sphere == 1
    assert found.words == f"free: {1e3 * found.distance:.0f} mm to sphere 2"
    touching = clearance(parts, poses, Spheres(tip[None], torch.tensor([0.1]).double()))
    assert touching.distance == pytest.approx(-0.1 - link_radius(robot), abs=0.05)
    assert touching.words.startswith("contact: -")


def test_a_motion_may_have_one_row(panda: ik.Robot):
    assert Motion("one", torch.zeros(1, 7).double()).tool_path(panda).shape == (1, 3)


# ---------------------------------------------------------------- the worker


def test_only_the_latest_of_like_tasks_is_done():
    worker, done, gate = Worker(), [], threading.Event()
    worker.submit("gate", gate.wait)
    for k in range(100):
        worker.submit("move", lambda k=k: done.append(k))
    worker.submit("other", lambda: done.append("other"))
    gate.set()
    assert worker.wait(10)
    worker.stop()
    assert done == [99, "other"]


def test_a_delayed_task_waits_and_can_be_dropped_or_put_off():
    worker, done = Worker(), []
    worker.submit("late", lambda: done.append("late"), delay=0.05)
    worker.submit("never", lambda: done.append("never"), delay=30.0)
    worker.submit("early", lambda: done.append("early"))
    assert not worker.wait(0.3)
    worker.drop("never")
    assert worker.wait(10)
    worker.stop()
    assert done == ["early", "late"]


def test_a_task_that_fails_is_logged_and_the_next_one_is_done(caplog: pytest.LogCaptureFixture):
    worker, done = Worker(), []
    with caplog.at_level(logging.ERROR):
        worker.submit("bad", lambda: 1 / 0)
        worker.submit("good", lambda: done.append(1))
        assert worker.wait(10)
    worker.stop()
    assert done == [1]
    assert "ZeroDivisionError" in caplog.text


def test_a_task_may_stop_its_own_worker():
    worker = Worker()
    worker.submit("stop", worker.stop)
    worker._thread.join(10)
    assert not worker._thread.is_alive()
