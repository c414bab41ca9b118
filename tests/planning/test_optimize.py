"""Trajectories around obstacles: what they keep, that rows are their own, and what is refused."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest
import torch
from support import ZOO
from torch import Tensor

import ikgrad as ik
from ikgrad.collision import Capsules, PolynomialMotion, Spheres, check_motion, link_segments
from ikgrad.planning.problem import make_problem

THICK, MARGIN = 0.06, 0.02  # of the arm's length


def spheres(robot: ik.Robot, count: int = 3) -> Spheres:
    centers = torch.tensor([[0.45, 0.1, 0.4], [-0.3, 0.4, 0.6], [0.0, -0.5, 0.3]], dtype=torch.float64)[:count]
    return Spheres(robot.length * centers, torch.full((count,), 0.12 * robot.length, dtype=torch.float64))


def clearance(robot: ik.Robot, obstacles: Spheres | Capsules, q: Tensor) -> Tensor:
    return obstacles.distance(link_segments(robot, q), THICK * robot.length).amin(dim=(-2, -1))


def pairs(robot: ik.Robot, count: int, *, collide: bool = True, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Ends that keep the margin, and whose straight motion does not."""
    obstacles = spheres(robot)
    q = ik.sample_configurations(robot, 60 * count, seed=seed)
    q = q[clearance(robot, obstacles, q) >= MARGIN * robot.length]
    a, b = q[: len(q) // 2 * 2].chunk(2)
    if collide:
        u = torch.linspace(0, 1, 50, dtype=torch.float64)[:, None]
        hit = clearance(robot, obstacles, a[:, None] + u * (b - a)[:, None]).amin(dim=1) < 0
        a, b = a[hit], b[hit]
    assert len(a) >= count
    return a[:count], b[:count]


def solve(robot: ik.Robot, a: Tensor, b: Tensor, **options: object) -> ik.OptimizedTrajectory:
    scene = {"margin": MARGIN * robot.length, "link_radius": THICK * robot.length}
    return ik.optimize_trajectory(robot, a, b, spheres(robot), **{**scene, **options})


@pytest.fixture(scope="module")
def sixty() -> tuple[ik.Robot, Tensor, Tensor, ik.OptimizedTrajectory]:
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 60)
    return robot, a, b, solve(robot, a, b, velocity_max=2.0, acceleration_max=torch.full((7,), 8.0))


def test_pairs_whose_straight_motion_collides_are_solved(sixty):
    robot, a, b, found = sixty
    line = ik.via_point_trajectory(torch.stack([a, b], dim=1), [0.0, 1.0], kind="quintic")
    thick = THICK * robot.length
    before = check_motion(robot, PolynomialMotion(line.times, line.coefficients), spheres(robot), link_radius=thick)
    assert bool(before.touches.all())
    assert float(found.success.double().mean()) >= 0.95
    path = found.trajectory
    after = check_motion(robot, PolynomialMotion(path.times, path.coefficients), spheres(robot), link_radius=thick)
    assert bool(after.free[found.success].all())


def test_successes_keep_everything_under_dense_sampling(sixty):
    robot, a, b, found = sixty
    path, good = found.trajectory, found.success
    t = path.duration[:, None] * torch.linspace(0, 1, 1991, dtype=torch.float64)  # every tenth is one of `clearance`'s
    q = path.position(t)
    gap = clearance(robot, spheres(robot), q).amin(dim=1)
    assert bool((gap[good] >= MARGIN * robot.length).all())
    assert bool((gap <= found.clearance + 1e-9).all())  # more samples find less
    assert bool((found.clearance - gap < 2e-3).all())
    assert bool(((q >= robot.q_min - 1e-9) & (q <= robot.q_max + 1e-9)).all(dim=(1, 2))[good].all())
    assert float(path.velocity(t).abs().max()) <= 2.0 + 1e-9
    assert float(path.acceleration(t).abs().max()) <= 8.0 + 1e-9
    torch.testing.assert_close(q[:, 0], a, rtol=0, atol=1e-12)
    torch.testing.assert_close(q[:, -1], b, rtol=0, atol=1e-9)
    for order in (1, 2):
        for end in (t[:, :1], t[:, -1:]):
            assert float(path(end, derivative=order).abs().max()) < 1e-8


def test_every_trajectory_uses_one_of_its_limits_up(sixty):
    _, _, _, found = sixty
    speed, push = found.trajectory.peak() / 2.0, found.trajectory.peak(derivative=2) / 8.0
    torch.testing.assert_close(torch.maximum(speed, push).amax(dim=1), torch.ones(60).double(), rtol=1e-9, atol=0)


def test_smoothness_leaves_a_free_straight_line_alone():
    robot = ik.load_robot("panda")
    far = Spheres(torch.tensor([[5.0, 0.0, 0.0]]), torch.tensor([0.1]))
    a, b = (robot.q_min.lerp(robot.q_max, w) for w in (0.3, 0.7))
    found = ik.optimize_trajectory(robot, a, b, far, duration=2.0)
    line = ik.via_point_trajectory(torch.stack([a, b]), [0.0, 2.0], kind="quintic")
    t = torch.linspace(0, 2, 50).double()
    torch.testing.assert_close(found.trajectory.position(t), line.position(t), rtol=0, atol=1e-9)
    assert int(found.steps) <= 2


def same(a: ik.OptimizedTrajectory, b: ik.OptimizedTrajectory, rows: object) -> bool:
    pick = [getattr(b, name)[rows] for name in ("success", "reason_code", "clearance", "steps")]
    own = [getattr(a, name) for name in ("success", "reason_code", "clearance", "steps")]
    pick += [b.trajectory.times[rows], b.trajectory.coefficients[rows]]
    own += [a.trajectory.times, a.trajectory.coefficients]
    return all(torch.equal(x, y) for x, y in zip(own, pick, strict=True))


@pytest.mark.parametrize(("name", "vias"), [("panda", 8), ("ur5e", 5), ("arm4", 3)])
def test_rows_do_not_depend_on_the_batch(name: str, vias: int):
    """Bit for bit, also for numbers of variables that are no multiple of a vector's width."""
    robot = ik.load_robot(name)
    a, b = pairs(robot, 24)
    options = {"vias": vias, "velocity_max": 1.0, "restarts": 2}
    whole = solve(robot, a, b, **options)
    assert len(whole.steps.unique()) >= 4  # rows leave the batch at different times
    order = torch.randperm(24, generator=torch.Generator().manual_seed(0))
    assert same(solve(robot, a[order], b[order], **options), whole, order)
    rows = slice(5, 12)
    assert same(solve(robot, a[rows], b[rows], **options), whole, rows)
    assert same(solve(robot, a[3], b[3], **options), whole, 3)


def test_rows_do_not_depend_on_blocks_and_threads(monkeypatch: pytest.MonkeyPatch):
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 20)
    whole, before = solve(robot, a, b), torch.get_num_threads()
    monkeypatch.setattr("ikgrad.planning.optimize._BLOCK", 7)
    try:
        torch.set_num_threads(2)
        assert same(solve(robot, a, b), whole, slice(None))
    finally:
        torch.set_num_threads(before)


def test_seeds_choose_the_detours_and_nothing_else():
    robot = ik.load_robot("ur5e")
    a, b = pairs(robot, 30)
    few = {"max_steps": 2}  # so that first descents fail
    first, again, other = (solve(robot, a, b, seed=seed, **few) for seed in (1, 1, 2))
    assert same(again, first, slice(None))
    tried_again = first.steps != solve(robot, a, b, restarts=0, **few).steps
    assert 0 < int(tried_again.sum()) < 30
    equal = (first.trajectory.coefficients == other.trajectory.coefficients).flatten(1).all(dim=1)
    assert bool(equal[~tried_again].all())
    assert not bool(equal[tried_again].all())


@pytest.mark.parametrize("name", ["ur5e", "arm4", "kr210", "iiwa14"])
def test_other_robots_are_solved_better_with_restarts(name: str):
    robot = ik.load_robot(name)
    a, b = pairs(robot, 40)
    line, once, often = (solve(robot, a, b, **o) for o in ({"max_steps": 1, "restarts": 0}, {"restarts": 0}, {}))
    assert int(line.success.sum()) < int(once.success.sum()) <= int(often.success.sum())
    assert bool((often.success | ~once.success).all())
    path, thick = often.trajectory, THICK * robot.length
    check = check_motion(robot, PolynomialMotion(path.times, path.coefficients), spheres(robot), link_radius=thick)
    assert bool(check.free[often.success].all())


def test_slides_mimic_joints_and_unlimited_joints(tmp_path: Path):
    (tmp_path / "zoo.urdf").write_text(ZOO)
    robot = ik.load_robot(tmp_path / "zoo.urdf", base="world", tip="hand")
    obstacles = Spheres(torch.tensor([[0.6, 0.5, 0.9]]).double(), torch.tensor([0.12]).double())
    q = ik.sample_configurations(robot, 600, seed=0)
    gap = obstacles.distance(link_segments(robot, q), 0.02).amin(dim=(-2, -1))
    a, b = q[gap >= 0.01][:200].chunk(2)
    found = ik.optimize_trajectory(robot, a, b, obstacles, margin=0.01, link_radius=0.02)
    line = ik.via_point_trajectory(torch.stack([a, b], dim=1), [0.0, 1.0], kind="quintic")
    before = check_motion(robot, PolynomialMotion(line.times, line.coefficients), obstacles, link_radius=0.03).free
    assert int((~before).sum()) >= 5
    assert int(found.success.sum()) > int(before.sum())
    low, high = found.trajectory.extremes()
    inside = ((low >= robot.q_min - 1e-9) & (high <= robot.q_max + 1e-9)).all(dim=-1)
    assert bool(inside[found.success].all())


def test_capsules_shapes_kinds_and_float32():
    robot = ik.load_robot("panda")
    pole = Capsules(torch.tensor([[[0.5, 0.0, 0.0], [0.5, 0.0, 0.9]]]), torch.tensor([0.06]))
    q = torch.tensor([0.9, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8])
    a = (q * torch.tensor([-1.0, 1, 1, 1, 1, 1, 1]) + torch.tensor([0.0, 0.1, 0.2])[:, None, None]).expand(3, 2, 7)
    for kind in ("quintic", "cubic", "4-3-4", "3-5-3"):
        found = ik.optimize_trajectory(robot, a, q, pole, link_radius=0.06, kind=kind)
        assert bool(found.success.all())
        assert found.success.shape == found.reason.shape == found.clearance.shape == found.trajectory.batch_shape
        assert found.success.shape == (3, 2)
        assert found.trajectory.coefficients.dtype == found.clearance.dtype == torch.float32
        thick, path = 0.06 + 0.02 - 1e-5, found.trajectory
        assert bool(
            check_motion(robot, PolynomialMotion(path.times, path.coefficients), pole, link_radius=thick).free.all()
        )


def test_an_empty_batch_is_answered():
    robot = ik.load_robot("panda")
    none = torch.zeros(0, 7)
    found = ik.optimize_trajectory(robot, none, none, spheres(robot))
    assert found.success.shape == (0,)
    assert found.trajectory.batch_shape == (0,)
    found.raise_if_failed()


def test_a_row_that_stands_still_stays_where_it_is():
    robot = ik.load_robot("panda")
    q, _ = pairs(robot, 1)
    found = solve(robot, q, q, velocity_max=1.0)
    assert bool(found.success.all())
    assert float(found.trajectory.duration) == 1.0
    assert float(found.trajectory.peak().max()) < 1e-9


def test_ends_at_the_limits_are_allowed():
    robot = ik.load_robot("panda")
    q = torch.tensor([0.9, 0.3, 0.0, -1.8, 0.0, 2.1, 2.8973]).double()
    q[6] = robot.q_max[6]
    other = q.clone()
    other[0] = robot.q_min[0]
    pole = Capsules(torch.tensor([[[0.5, 0.0, 0.0], [0.5, 0.0, 0.9]]]), torch.tensor([0.06]))
    found = ik.optimize_trajectory(robot, q, other, pole, link_radius=0.06)
    assert found.reason.item() == "converged"
    assert float(found.trajectory.extremes()[1][6]) <= float(robot.q_max[6]) + 1e-9


def test_ends_that_collide_are_named():
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 3)
    hand = link_segments(robot, a[1])[-1, 1]
    inside = Spheres(hand[None], torch.tensor([0.05], dtype=torch.float64))
    found = ik.optimize_trajectory(robot, torch.stack([a[0], a[1], a[1]]), torch.stack([a[1], b[1], a[1]]), inside)
    assert found.reason.tolist() == ["goal_collides", "start_collides", "start_collides"]
    assert found.steps.tolist() == [0, 0, 0]
    assert bool((found.clearance < 0).all())
    assert found.counts() == {"start_collides": 2, "goal_collides": 1}
    with pytest.raises(ik.PlanningError, match=r"3 of 3 trajectories failed: q_goal\[0\] touches an obstacle or is ne"):
        found.raise_if_failed()
    single = ik.optimize_trajectory(robot, a[1], b[1], inside)
    with pytest.raises(ik.PlanningError, match="failed: q_start touches an obstacle or is nearer than margin") as error:
        single.raise_if_failed()
    assert error.value.result is single


def test_ends_that_barely_keep_the_margin_are_proven():
    """A proof coarser than what an end has beyond the margin would fail whatever the way."""
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 40)
    gap = clearance(robot, spheres(robot), a)
    for row in gap.argsort()[:5]:
        found = solve(robot, a[row], b[row], margin=float(gap[row]) - 3e-5)
        assert bool(found.success)
        assert float(found.clearance) <= float(gap[row])


def test_no_way_is_said_to_be_none():
    """A ring of capsules around the column: the upper arm cannot pass."""
    robot = ik.load_robot("panda")
    turn = torch.linspace(0, 2 * math.pi, 13).double()
    ring = torch.stack([0.45 * turn.cos(), 0.45 * turn.sin(), torch.full_like(turn, 0.35)], dim=-1)
    wall = Capsules(torch.stack([ring[:-1], ring[1:]], dim=1), torch.full((12,), 0.05).double())
    a = torch.tensor([0.0, 0.0, 0.0, -0.1, 0.0, 1.6, 0.8]).double()
    b = torch.tensor([0.0, 1.7, 0.0, -0.1, 0.0, 1.6, 0.8]).double()
    found = ik.optimize_trajectory(robot, a, b, wall, link_radius=0.05, restarts=1)
    assert found.reason.item() == "no_convergence"
    assert bool(found.trajectory.coefficients.isfinite().all())
    assert float(found.clearance) < 0.02
    with pytest.raises(ik.PlanningError, match=r"row \[\] found no way \(smallest distance .* try more restarts"):
        found.raise_if_failed()


def test_the_gradient_is_that_of_the_cost():
    """With sliding and turning joints alike, in contact with obstacles and limits at once."""
    from ikgrad.planning.curve import make_curve

    robot = ik.load_robot("panda")
    a, b = pairs(robot, 6)
    curve = make_curve(4, "quintic", 5, 10, a.device)
    for arm in (
        robot,
        dataclasses.replace(robot, variables=tuple(v._replace(kind="prismatic") for v in robot.variables)),
    ):
        problem = make_problem(arm, spheres(robot), curve, a, b, 0.02, 0.06, 1e-6)
        vias = curve.times[1:-1, None] * (b - a)[:, None] + a[:, None]
        vias = vias + 0.8 * torch.randn(vias.shape, generator=torch.Generator().manual_seed(0)).double()
        model = problem.model(vias)
        q = curve.at_samples(problem.points(vias))
        assert bool((problem.intrusion(q) > 0).any())
        assert bool((q > problem.high[:, None]).any())
        way = torch.randn(vias.shape, generator=torch.Generator().manual_seed(1)).double()
        h = 1e-6
        rise = (problem.cost(vias + h * way) - problem.cost(vias - h * way)) / (2 * h)
        slope = (model.gradient[:, : vias[0].numel()] * way.flatten(1)).sum(dim=1)
        torch.testing.assert_close(slope, rise, rtol=1e-5, atol=1e-9)
        torch.testing.assert_close(model.cost, problem.cost(vias))


def test_the_curvature_is_that_of_the_linearised_residuals():
    from torch.func import jacrev

    from ikgrad.planning.curve import make_curve
    from ikgrad.planning.problem import Problem

    robot = ik.load_robot("ur5e")
    a, b = pairs(robot, 1)
    curve = make_curve(2, "quintic", 4, 10, a.device)
    problem: Problem = make_problem(robot, spheres(robot), curve, a, b, 0.02, 0.06, 1e-6)
    vias = 4.0 * torch.randn(1, 2, 6, generator=torch.Generator().manual_seed(3)).double()
    assert bool((problem._outside(curve.at_samples(problem.points(vias))) != 0).any())

    def residuals(x: Tensor) -> Tensor:
        q = curve.at_samples(problem.points(x[None]))
        return torch.cat([problem.intrusion(q).flatten(), problem._outside(q).flatten()])

    J = jacrev(residuals)(vias[0]).flatten(1)
    model = problem.model(vias)
    torch.testing.assert_close(model.curvature[0, :12, :12], J.mT @ J / 11, rtol=1e-9, atol=1e-12)


REFUSALS = [
    ({"margin": -0.1}, "margin must be a finite number that is not negative, got -0.1"),
    ({"link_radius": math.nan}, "link_radius must be a finite number that is not negative, got nan"),
    ({"duration": 0.0}, "duration must be a positive finite number, got 0"),
    ({"vias": 0}, "vias must be at least 1, got 0"),
    ({"max_steps": 0}, "max_steps must be at least 1, got 0"),
    ({"restarts": -1}, "restarts must be at least 0, got -1"),
    ({"margin": math.nan}, "margin must be a finite number that is not negative, got nan"),
    ({"duration": math.nan}, "duration must be a positive finite number, got nan"),
    ({"acceleration_max": math.nan}, "acceleration_max must be positive, got nan"),
    ({"velocity_max": [1.0] * 6 + [0.0]}, r"velocity_max\[6\] must be positive, got 0"),
]


@pytest.mark.parametrize(("options", "text"), REFUSALS, ids=lambda x: next(iter(x)) if isinstance(x, dict) else "")
def test_settings_that_make_no_sense_are_refused(options: dict[str, object], text: str):
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 1)
    with pytest.raises(ik.ConfigError, match=text):
        solve(robot, a, b, **options)


def test_bad_ends_are_refused_by_entry():
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 3)
    high, low, nan = b.clone(), a.clone(), a.clone()
    high[2, 3], low[1, 0], nan[0, 6] = 0.5, -3.0, math.nan
    with pytest.raises(
        ik.ConfigError, match=r"q_goal must not lie above the upper limit -0\.0698 of 'panda_joint4', b"
    ):
        solve(robot, a, high)
    with pytest.raises(ik.ConfigError, match=r"but q_goal\[2, 3\] is 0\.5"):
        solve(robot, a, high)
    with pytest.raises(
        ik.ConfigError, match=r"below the lower limit -2\.8973 of 'panda_joint1', but q_start\[1, 0\] is"
    ):
        solve(robot, low, b)
    with pytest.raises(ik.ConfigError, match=r"q_start must be finite, but q_start\[0, 6\] is nan"):
        solve(robot, nan, b)
    with pytest.raises(ik.ShapeError, match=r"q_goal must have shape \(\.\.\., 7\) for robot 'panda', got \(3, 6\)"):
        solve(robot, a, b[:, :6])
    with pytest.raises(ik.ShapeError, match=r"q_start \(3, 7\) and q_goal \(2, 7\) do not broadcast"):
        solve(robot, a, b[:2])
    with pytest.raises(
        ik.ShapeError, match=r"must have one dtype and device, got torch\.float64 on cpu and torch\.float32"
    ):
        solve(robot, a, b.float())


@pytest.mark.parametrize(
    ("radii", "text"),
    [
        ([0.1, 0.0], r"radii must be positive, but radii\[1\] is 0"),
        ([-0.1, 0.1], r"radii must be positive, but radii\[0\] is -0\.1"),
        ([0.1, math.nan], r"radii must be finite, but radii\[1\] is nan"),
    ],
)
@pytest.mark.parametrize(("kind", "shape"), [(Spheres, (2, 3)), (Capsules, (2, 2, 3))])
def test_obstacles_without_a_radius_are_refused_before_planning(
    kind: type[Spheres] | type[Capsules], shape: tuple[int, ...], radii: list[float], text: str
):
    with pytest.raises(ik.ConfigError, match=text):
        kind(torch.rand(shape), torch.tensor(radii))


def test_times_outside_what_was_planned_are_refused():
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 2)
    found = solve(robot, a, b, duration=2.0, restarts=0)
    with pytest.raises(ik.ConfigError, match=r"t = 2\.5 lies outside the trajectory, 0 to 2 s"):
        found.trajectory.position(2.5)
    with pytest.raises(ik.ConfigError, match=r"t = nan lies outside the trajectory"):
        found.trajectory.position(math.nan)


def test_obstacles_of_another_form_are_refused():
    robot = ik.load_robot("panda")
    a, b = pairs(robot, 2)
    with pytest.raises(
        ik.ShapeError, match=r"the same K for all rows, got radii of shape \(2, 1\); plan scene by scene"
    ):
        ik.optimize_trajectory(robot, a, b, Spheres(torch.zeros(2, 1, 3), torch.ones(2, 1)))
    with pytest.raises(ik.ShapeError, match=r"obstacles must be Spheres or Capsules of ikgrad\.collision, got Tensor"):
        ik.optimize_trajectory(robot, a, b, torch.zeros(3))
    with pytest.raises(ik.UnknownNameError, match="unknown trajectory kind 'septic'"):
        solve(robot, a, b, kind="septic")
