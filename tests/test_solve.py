"""`solve_ik`: success is measured, rows are independent, failure has a reason, and questions are checked."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from support import BUILTIN

import ikgrad as ik
from ikgrad.solvers.attempt import whole_turns
from ikgrad.solvers.question import ask
from ikgrad.solvers.solve import trace_ik

SHAPES = [(), (1,), (3, 1, 2), (0,)]
METHODS = [ik.LevenbergMarquardt(), ik.LevenbergMarquardt(compiled=False), ik.NewtonRaphson(), ik.Apps(max_steps=3000)]


def reachable(robot: ik.Robot, shape: tuple[int, ...] = (20,), seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    q = ik.sample_configurations(robot, math.prod(shape), seed=seed).reshape(*shape, robot.dof)
    return q, ik.forward_kinematics(robot, q)


def assert_solved(robot: ik.Robot, solution: ik.IKSolution, T: torch.Tensor, *, limits: bool = True) -> None:
    """Independent check of every row that claims success."""
    e = ik.pose_error(ik.forward_kinematics(robot, solution.q.double()), T.double())
    ok = solution.success
    assert bool((e[..., :3].norm(dim=-1)[ok] <= 1.0001e-6).all())
    assert bool((e[..., 3:].norm(dim=-1)[ok] <= 1.0001e-6).all())
    if limits:
        inside = (solution.q >= robot.q_min) & (solution.q <= robot.q_max)
        assert bool(inside[ok].all())


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("compiled", [True, False])
def test_reachable_poses_are_solved_in_any_batch_shape(robot: ik.Robot, shape: tuple[int, ...], compiled: bool):
    _, T = reachable(robot, shape, seed=int(compiled))
    before = T.clone()
    solution = ik.solve_ik(robot, T, solver=ik.LevenbergMarquardt(compiled=compiled))
    assert solution.q.shape == (*shape, robot.dof)
    for field in (solution.success, solution.reason, solution.position_error, solution.rotation_error, solution.steps):
        assert tuple(field.shape) == shape
    assert bool(solution.success.all())
    assert_solved(robot, solution, T)
    assert torch.equal(T, before)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_every_method_finds_a_nearby_solution(robot: ik.Robot, method):
    low, high = robot.sampling_range
    q = low + (
        0.3 + 0.4 * torch.rand(4, robot.dof, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    ) * (high - low)
    if isinstance(method, ik.Apps):
        if robot.name == "arm4":
            pytest.skip("metres outweigh rotations 900 to 1 on a 30 m arm: plain gradient descent takes forever")
        method = replace(method, eta=0.1 / max(1.0, robot.length**2 / 4))  # the step that stays stable
    T = ik.forward_kinematics(robot, q)
    solution = ik.solve_ik(robot, T, q0=q + 0.02, solver=method, tol_pos=1e-3 * robot.length, tol_rot=1e-3)
    assert bool(solution.success.all()), solution.reason
    assert float((solution.q - q).abs().max()) < 0.5


def test_rows_do_not_depend_on_the_batch(panda: ik.Robot):
    _, T = reachable(panda, (12,))
    whole = ik.solve_ik(panda, T)
    order = torch.randperm(12, generator=torch.Generator().manual_seed(0))
    shuffled = ik.solve_ik(panda, T[order])
    torch.testing.assert_close(shuffled.q, whole.q[order], rtol=0, atol=1e-9)
    assert torch.equal(shuffled.steps, whole.steps[order])
    for row in range(12):
        alone = ik.solve_ik(panda, T[row])
        torch.testing.assert_close(alone.q, whole.q[row], rtol=0, atol=1e-9)
        assert alone.steps == whole.steps[row]


def test_the_seed_decides_the_starts(panda: ik.Robot):
    _, T = reachable(panda, (5,))
    assert torch.equal(ik.solve_ik(panda, T, seed=3).q, ik.solve_ik(panda, T, seed=3).q)
    plain = ik.LevenbergMarquardt(compiled=False)
    assert not torch.equal(ik.solve_ik(panda, T, seed=3, solver=plain).q, ik.solve_ik(panda, T, seed=4, solver=plain).q)
    hard = ik.forward_kinematics(panda, ik.sample_configurations(panda, 3000, seed=8))
    steps = [ik.solve_ik(panda, hard, seed=seed).steps for seed in (3, 4)]  # few rows come to the random starts
    assert not torch.equal(*steps)


def test_q0_is_broadcast_and_kept_near(panda: ik.Robot):
    q, T = reachable(panda, (6,))
    middle = (panda.q_min + panda.q_max) / 2
    near = torch.lerp(q, middle, 0.05)
    solution = ik.solve_ik(panda, T, q0=near)
    assert bool(solution.success.all())
    assert float((solution.q - near).abs().max()) < 1.0
    shared = ik.solve_ik(panda, T, q0=middle)
    assert bool(shared.success.all())
    torch.testing.assert_close(shared.q, ik.solve_ik(panda, T, q0=middle.expand(6, 7)).q)


def test_a_start_outside_the_limits_is_brought_inside(panda: ik.Robot):
    _, T = reachable(panda, (5,))
    solution = ik.solve_ik(panda, T, q0=torch.full((7,), 50.0, dtype=torch.float64))
    assert bool(solution.success.all())
    assert_solved(panda, solution, T)


@pytest.mark.parametrize("name", ["panda", "iiwa14", "ur5e", "kr210"])
def test_a_followed_path_does_not_jump(name: str):
    """Closed joint-space curves about comfortable configurations, q0 = the last answer, every tick a batch."""
    robot = ik.load_robot(name)
    low, high = robot.sampling_range
    generator = torch.Generator().manual_seed(0)
    middle = low + (0.2 + 0.6 * torch.rand(100, robot.dof, dtype=torch.float64, generator=generator)) * (high - low)
    phase = 2 * math.pi * torch.rand(100, robot.dof, dtype=torch.float64, generator=generator)
    ticks = torch.linspace(0, 2 * math.pi, 300, dtype=torch.float64)[:, None, None]
    path = middle + 0.3 * torch.sin(ticks + phase)
    smooth = torch.linalg.svdvals(ik.jacobian(robot, path))[..., -1].amin(dim=0) > 0.03 * min(1.0, robot.length)
    path = path[:, smooth][:, :8]
    assert path.shape[1] == 8
    q = path[0]
    for tick in path:
        solution = ik.solve_ik(robot, ik.forward_kinematics(robot, tick), q0=q)
        assert bool(solution.success.all())
        assert float((solution.q - q).abs().max()) < 0.2
        q = solution.q


@pytest.mark.parametrize("name", BUILTIN)
def test_solutions_are_different_sorted_and_valid(name: str):
    robot = ik.load_robot(name)
    q, T = reachable(robot, (3,), seed=4)
    mask = (1, 1, 1, 0, 0, 0) if name == "arm4" else None
    solution = ik.solve_ik(robot, T, q0=q, solutions=4, mask=mask)
    assert solution.q.shape == (3, 4, robot.dof)
    assert bool(solution.success[:, 0].all())
    if mask is None:
        assert_solved(robot, solution, T[:, None].expand(3, 4, 4, 4))
    distance = (solution.q - q[:, None]).abs().amax(dim=-1)
    for row in range(3):
        ok = solution.success[row]
        assert bool((distance[row][ok].diff() >= 0).all())
        assert not bool(ok.int().diff().gt(0).any())  # failures stand last
        kept = solution.q[row][ok]
        for i in range(len(kept)):
            for j in range(i):
                change = kept[i] - kept[j]
                change = torch.where(
                    robot.periodic, torch.remainder(change + torch.pi, 2 * torch.pi) - torch.pi, change
                )
                assert float(change.abs().max()) > 1e-3


def test_a_six_joint_arm_has_a_finite_number_of_solutions():
    robot = ik.load_robot("puma560")
    q, T = reachable(robot, (2,), seed=1)
    solution = ik.solve_ik(robot, T, q0=q, solutions=20, limits=False)
    assert solution.success.sum(dim=1).tolist() == [8, 8]
    assert set(solution.reason[0, 8:]) == {"no_convergence"}
    assert bool(solution.q.isfinite().all())
    closest = ik.solve_ik(robot, T, q0=q, solutions=1)
    torch.testing.assert_close(solution.q[:, 0], closest.q, rtol=0, atol=1e-5)


def test_mask_leaves_the_turn_about_the_tools_own_axis_free():
    robot = ik.load_robot("ur5e")
    _, T = reachable(robot, (30,), seed=2)
    solution = ik.solve_ik(robot, T, mask=(1, 1, 1, 1, 1, 0))
    assert bool(solution.success.all())
    reached = ik.forward_kinematics(robot, solution.q)
    torch.testing.assert_close(reached[:, :3, 3], T[:, :3, 3], rtol=0, atol=2e-6)
    torch.testing.assert_close(reached[:, :3, 2], T[:, :3, 2], rtol=0, atol=2e-6)
    assert float((reached[:, :3, 0] - T[:, :3, 0]).abs().max()) > 0.1  # and it is used


def test_mask_along_the_targets_own_axis_and_position_only(robot: ik.Robot):
    _, T = reachable(robot, (10,), seed=3)
    position_only = ik.solve_ik(robot, T, mask=(1, 1, 1, 0, 0, 0))
    assert bool(position_only.success.all())
    assert float(position_only.rotation_error.max()) == 0.0
    reached = ik.forward_kinematics(robot, position_only.q)
    torch.testing.assert_close(reached[:, :3, 3], T[:, :3, 3], rtol=0, atol=2e-6)
    plane = ik.solve_ik(robot, T, mask=(1, 0, 0, 0, 0, 0))
    assert bool(plane.success.all())
    missing = (T[:, :3, 3] - ik.forward_kinematics(robot, plane.q)[:, :3, 3])[:, None] @ T[:, :3, :3]
    assert float(missing[:, 0, 0].abs().max()) < 2e-6


def test_too_far_targets_are_unreachable(robot: ik.Robot):
    if not math.isfinite(robot.reach_bound):
        pytest.skip("a slide without limits reaches everywhere")
    _, T = reachable(robot, (3,))
    T = T.clone()
    T[:, :3, 3] += 3 * robot.length
    solution = ik.solve_ik(robot, T)
    assert set(solution.reason) == {"unreachable"}
    assert not bool(solution.success.any())
    assert bool(solution.q.isfinite().all())
    e = ik.pose_error(ik.forward_kinematics(robot, solution.q), T)
    torch.testing.assert_close(solution.position_error, e[:, :3].norm(dim=-1))


def test_a_pose_beyond_the_limits_says_so():
    robot = ik.load_robot("ur5e")
    narrow = replace(robot, variables=tuple(v._replace(q_min=-0.4, q_max=0.4) for v in robot.variables), _tables={})
    q = torch.full((6,), 0.6, dtype=torch.float64)
    T = ik.forward_kinematics(robot, q)
    assert ik.solve_ik(narrow, T).reason == "joint_limits"
    assert ik.solve_ik(narrow, T, limits=False).reason == "converged"
    newton = ik.solve_ik(narrow, T, q0=q + 0.01, solver=ik.NewtonRaphson())
    assert newton.reason == "joint_limits"
    assert float(newton.position_error) < 1e-6


def bad_targets(T: torch.Tensor) -> torch.Tensor:
    bad = T.expand(6, 4, 4).clone()
    bad[0, 0, 0] = math.nan
    bad[1, 2, 3] = math.inf
    bad[2, :3, :3] *= 1.01
    bad[3, :3, 2] *= -1  # a reflection
    bad[4, 3, 3] = 2.0
    bad[5] = 0.0
    return bad


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_one_bad_row_does_not_touch_the_others(panda: ik.Robot, method):
    q, T = reachable(panda, (2,))
    batch = torch.cat([T[:1], bad_targets(T[0]), T[1:]])
    start = torch.cat([q[:1], q[:1].expand(6, 7), q[1:]]) + 0.01
    solution = ik.solve_ik(panda, batch, q0=start, solver=method, tol_pos=1e-4, tol_rot=1e-4)
    assert solution.reason.tolist() == ["converged", *["invalid_target"] * 6, "converged"]
    assert bool(solution.q.isfinite().all())
    assert bool(solution.position_error[1:7].isnan().all())


def test_a_start_that_is_not_finite_invalidates_its_row_only(panda: ik.Robot):
    q, T = reachable(panda, (3,))
    start = q.clone()
    start[1, 4] = math.nan
    assert ik.solve_ik(panda, T, q0=start).reason.tolist() == ["converged", "invalid_target", "converged"]


def test_results_have_the_dtype_of_the_target_and_keep_the_limits(robot: ik.Robot):
    _, T = reachable(robot, (50,))
    solution = ik.solve_ik(robot, T.float(), tol_pos=2e-6 * robot.length, tol_rot=2e-6)
    assert solution.q.dtype == torch.float32
    inside = (solution.q.double() >= robot.q_min) & (solution.q.double() <= robot.q_max)
    assert bool(inside.all())
    assert solution.success.float().mean() > 0.9  # float32 joints cannot hold every pose to 2e-6


def test_raise_if_failed_counts_reasons_and_carries_the_solution(panda: ik.Robot):
    _, T = reachable(panda, (3,))
    T = T.clone()
    T[1, :3, 3] = 9.0
    solution = ik.solve_ik(panda, T)
    text = r"1 of 3 rows failed \(1 unreachable\); worst errors .* m and .* rad. Try another q0"
    with pytest.raises(ik.ConvergenceError, match=text) as caught:
        solution.raise_if_failed()
    assert caught.value.solution is solution
    assert solution.counts() == {"converged": 2, "unreachable": 1}
    fine = ik.solve_ik(panda, T[0])
    assert fine.raise_if_failed() is fine


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (dict(T_target=torch.zeros(3, 4)), ik.ShapeError, r"T_target must have shape \(..., 4, 4\), got \(3, 4\)"),
        (dict(T_target="pose"), ik.ShapeError, "T_target must be a floating-point tensor, got str"),
        (dict(q0=torch.zeros(6)), ik.ShapeError, r"q0 must have shape \(..., 7\) for robot 'panda', got \(6,\)"),
        (dict(q0=torch.zeros(3, 7)), ik.ShapeError, r"q0 of shape \(3, 7\) does not fit poses of shape \(2, 4, 4\)"),
        (dict(tol_pos=0.0), ik.ConfigError, "tol_pos must be positive, got 0"),
        (dict(tol_rot=-1.0), ik.ConfigError, "tol_rot must be positive, got -1"),
        (dict(tol_rot=math.nan), ik.ConfigError, "tol_rot must be positive, got nan"),
        (dict(solutions=0), ik.ConfigError, "solutions must be at least 1, got 0"),
        (dict(mask=(1, 1, 1)), ik.ShapeError, r"mask must have shape \(6,\), got \(3,\)"),
        (dict(mask=(1, 1, 0.5, 0, 0, 0)), ik.ConfigError, "mask must be six zeros or ones"),
        (dict(mask=(0,) * 6), ik.ConfigError, "mask must be six zeros or ones, not all zero"),
    ],
)
def test_bad_questions_are_refused(panda: ik.Robot, arguments: dict, error: type, text: str):
    arguments = {"T_target": torch.eye(4).expand(2, 4, 4), **arguments}
    with pytest.raises(error, match=text):
        ik.solve_ik(panda, arguments.pop("T_target"), **arguments)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: ik.Apps(eta=0), "Apps: eta must be positive, got 0"),
        (lambda: ik.Apps(E0=-1), "Apps: E0 must be positive, got -1"),
        (lambda: ik.NewtonRaphson(max_steps=0), "NewtonRaphson: max_steps must be positive"),
        (lambda: ik.LevenbergMarquardt(damping=math.nan), "LevenbergMarquardt: damping must be positive, got nan"),
    ],
)
def test_bad_settings_are_refused(make, text: str):
    with pytest.raises(ik.ConfigError, match=text):
        make()


# --- the pieces ---------------------------------------------------------------------------------------------------


def test_whole_turns_is_equation_12_of_the_apps_paper():
    robot = ik.load_robot("kr210")
    T = torch.eye(4, dtype=torch.float64)[None]
    problem = ask(robot, T, q0=None, tol_pos=1e-6, tol_rot=1e-6, limits=True, mask=None, seed=0).problem
    deg = torch.tensor([[10.0, 60.0, 200.0, 360.1614, -10.0, -351.0]], dtype=torch.float64)
    wrapped = torch.rad2deg(whole_turns(problem, torch.deg2rad(deg), torch.deg2rad(deg)))
    # theta_2 = 60 would become -300: no turn brings it into -95..50, so it is left for the range check
    expected = torch.tensor([[10.0, 60.0, 200.0, 0.1614, -10.0, 9.0]], dtype=torch.float64)
    torch.testing.assert_close(wrapped, expected, rtol=0, atol=1e-10)
    near = whole_turns(problem, torch.deg2rad(deg), torch.deg2rad(deg) - 2 * math.pi)
    assert torch.rad2deg(near)[0, 3].item() == pytest.approx(0.1614 - 360 + 360, abs=1e-9)


def test_a_mimic_joint_is_not_turned_by_whole_turns(zoo_path):
    robot = ik.load_robot(zoo_path, tip="hand")
    q, T = reachable(robot, (5,))
    start = q + torch.tensor([2 * math.pi, 0, 0], dtype=torch.float64)
    solution = ik.solve_ik(robot, T, q0=start)
    assert_solved(robot, solution, T)
    assert bool(solution.success.all())


def test_apps_energy_is_the_sum_of_squared_pose_entries_and_its_gradient_j_transpose_e():
    robot = ik.load_robot("kr210")
    q, T = reachable(robot, (4,))
    problem = ask(robot, T.roll(1, 0), q0=None, tol_pos=1e-6, tol_rot=1e-6, limits=True, mask=None, seed=0).problem
    solver = ik.Apps()
    expected = (T.roll(1, 0) - T)[:, :3].square().sum(dim=(1, 2))
    torch.testing.assert_close(solver.energy(problem, q), expected)
    torch.testing.assert_close(ik.Apps(half_sum=True).energy(problem, q), expected / 2)
    gradient = solver.init(problem, q).memory["gradient"]
    entries = torch.func.vmap(torch.func.jacrev(lambda x: ik.forward_kinematics(robot, x)[:3].flatten()))(q)
    e = (T.roll(1, 0) - T)[:, :3].flatten(1)
    torch.testing.assert_close(gradient, -2 * (entries.mT @ e[..., None])[..., 0], rtol=1e-10, atol=1e-10)


def test_apps_never_moves_a_joint_by_more_than_its_limit():
    robot = ik.load_robot("kr210")
    q, T = reachable(robot, (2,))
    for solver in (ik.Apps(max_steps=50), ik.Apps(max_steps=50, literal=True)):
        trace = trace_ik(robot, T[0], q0=q[1], solver=solver, limits=False)
        moves = trace.q.diff(dim=0).abs()
        assert float(moves.max()) <= math.pi / 180 + 1e-12
        if solver.literal:  # all or nothing
            assert bool(((moves < 1e-15) | (moves > math.pi / 180 - 1e-12)).all())


def test_apps_presets_are_the_papers():
    assert ik.Apps.printed() == ik.Apps(eta=0.01, E0=1e-8, half_sum=True, step_limit=math.pi / 180, max_steps=1000)
    assert ik.Apps.reproduces() == ik.Apps(eta=0.1, E0=1e-9, half_sum=False, step_limit=math.pi / 180, max_steps=1000)


def test_newton_in_the_tool_frame_is_inconsistent():
    robot = ik.load_robot("kr210")
    q, T = reachable(robot, (5,))
    good = ik.solve_ik(robot, T, q0=q + 0.05, solver=ik.NewtonRaphson(), limits=False)
    bad = ik.solve_ik(robot, T, q0=q + 0.05, solver=ik.NewtonRaphson(tool_frame_error=True), limits=False)
    assert bool(good.success.all())
    assert not bool(bad.success.all())


def test_levenberg_marquardt_stays_inside_the_limits_at_every_step(panda: ik.Robot):
    q, T = reachable(panda, (2,))
    trace = trace_ik(panda, T[0], q0=q[1])
    assert bool(((trace.q >= panda.q_min) & (trace.q <= panda.q_max)).all())
    assert float(trace.position_error[-1]) < 1e-6


def test_trace_agrees_with_solve(panda: ik.Robot):
    q, T = reachable(panda, (2,))
    trace = trace_ik(panda, T[0], q0=q[0] + 0.1)
    solution = ik.solve_ik(panda, T[0], q0=q[0] + 0.1, solver=ik.LevenbergMarquardt(compiled=False))
    assert len(trace.q) == int(solution.steps)
    torch.testing.assert_close(trace.q[-1], solution.q)
    with pytest.raises(ik.ShapeError, match=r"T_target must have shape \(4, 4\) here"):
        trace_ik(panda, T, q0=q)
    with pytest.raises(ik.ConfigError, match="must be a rigid transform"):
        trace_ik(panda, 2 * T[0], q0=q[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5e", "iiwa14", "puma560", "kr210", "denso_vp6242"])
def test_two_thousand_cold_poses(name: str):
    robot = ik.load_robot(name)
    _, T = reachable(robot, (2000,), seed=5)
    solution = ik.solve_ik(robot, T)
    assert_solved(robot, solution, T)
    assert float(solution.success.double().mean()) >= 0.999
