"""The PUMA 560 in closed form: branches against forward kinematics, their labels, gradients, edges, and the solver."""

from __future__ import annotations

import csv
import math
from importlib.resources import files

import pytest
import torch

import ikgrad as ik
from ikgrad.solvers.puma560 import A2, A3, BRANCHES, D2, D4, Z0

SHAPES = [(), (1,), (3, 1, 2), (0,)]
PUMA = ik.load_robot("puma560")


def configurations(count: int, seed: int = 0) -> torch.Tensor:
    return ik.sample_configurations(PUMA, count, seed=seed)


def worst_errors(branches, T: torch.Tensor) -> tuple[float, float]:
    """Largest position [m] and rotation [rad] error of the valid branches, by forward kinematics."""
    q, valid = branches
    e = ik.pose_error(ik.forward_kinematics(PUMA, q.detach().double()), T.double()[..., None, :, :])[valid]
    return float(e[:, :3].norm(dim=-1).max()), float(e[:, 3:].norm(dim=-1).max())


def turned(change: torch.Tensor) -> torch.Tensor:
    """Largest joint change modulo whole turns."""
    return (change - 2 * math.pi * torch.round(change / (2 * math.pi))).abs().amax(dim=-1)


def table1() -> list[dict[str, float]]:
    text = (files("ikgrad.papers") / "data" / "puma_table1_corrected.csv").read_text()
    return [{k: float(v) for k, v in row.items() if k != "changes"} for row in csv.DictReader(text.splitlines())]


def assert_round_trip(count: int, seed: int) -> None:
    q = configurations(count, seed)
    T = ik.forward_kinematics(PUMA, q)
    every = ik.puma560_ik(T, limits=False)
    assert bool(every.valid.all())
    assert float(every.q.abs().max()) <= math.pi
    inside = ik.puma560_ik(T)
    for branches in (every, inside):
        assert max(worst_errors(branches, T)) < 1e-9
    distance = turned(inside.q - q[:, None]).where(inside.valid, math.inf)
    assert float(distance.amin(dim=1).max()) < 1e-6  # near a fold of the arm an angle is known to sqrt(1e-16) at best
    assert bool(((inside.q >= PUMA.q_min) & (inside.q <= PUMA.q_max)).all(dim=-1)[inside.valid].all())


def test_every_valid_branch_gives_the_pose_and_the_original_is_among_them():
    assert_round_trip(20_000, seed=0)


@pytest.mark.slow
def test_every_valid_branch_gives_the_pose_for_many():
    assert_round_trip(100_000, seed=1)


def test_the_constants_are_those_of_the_built_in_robot():
    q = configurations(10)
    rows = [dict(alpha=-math.pi / 2, d=Z0), dict(a=A2, d=D2), dict(a=A3, alpha=math.pi / 2)]
    rows += [dict(d=D4, alpha=-math.pi / 2), dict(alpha=math.pi / 2), dict()]
    arm = ik.Robot.from_dh(rows, convention="standard")
    torch.testing.assert_close(ik.forward_kinematics(arm, q), ik.forward_kinematics(PUMA, q), rtol=0, atol=1e-12)


def test_labels_say_what_the_arm_looks_like():
    T = ik.forward_kinematics(PUMA, configurations(300, seed=2))
    q, _ = ik.puma560_ik(T, limits=False)
    poses = ik.link_poses(PUMA, q)
    names = list(PUMA.link_names)
    base, tip = names.index("base_link"), names.index("flange")
    wrist = poses[..., tip, :3, 3] - poses[..., base, :3, 3] - torch.tensor([0, 0, Z0]).double()
    forward = torch.stack([q[..., 0].cos(), q[..., 0].sin()], dim=-1)
    rho = (wrist[..., :2] * forward).sum(dim=-1)  # ahead of the shoulder or behind
    elbow = A2 * q[..., 1].cos(), -A2 * q[..., 1].sin()  # in the plane of the arm: along rho and up
    above = elbow[1] * rho.abs() > wrist[..., 2] * elbow[0] * rho.sign()  # the line from shoulder to wrist
    for b, (shoulder, up, flip) in enumerate(BRANCHES):
        assert bool(((rho[:, b] > 0) == (shoulder == "left")).all())
        assert bool((above[:, b] == (up == "up")).all())
        assert bool(((q[:, b, 4] < 0) == (flip == "flip")).all())


def test_corrected_table_1_is_recovered():
    for row in table1():
        T = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64))
        T[:3, 3] = torch.tensor([row["px_mm"], row["py_mm"], row["pz_mm"]], dtype=torch.float64) / 1000
        q, valid = ik.puma560_ik(T)
        assert bool(valid[0])
        expected = torch.tensor([row[f"theta{j}_deg"] for j in range(1, 7)], dtype=torch.float64)
        assert float((torch.rad2deg(q[0]) - expected).abs().max()) < 0.015, row["row"]


@pytest.mark.parametrize("shape", SHAPES)
def test_any_batch_shape_gives_the_answers_of_single_poses(shape: tuple[int, ...]):
    T = ik.forward_kinematics(PUMA, configurations(math.prod(shape)).reshape(*shape, 6))
    before = T.clone()
    branches = ik.puma560_ik(T)
    q, valid = branches
    assert q.shape == (*shape, 8, 6)
    assert valid.shape == branches.singular.shape == (*shape, 8)
    assert valid.dtype == branches.singular.dtype == torch.bool
    assert torch.equal(T, before)
    flat = zip(T.reshape(-1, 4, 4), q.reshape(-1, 8, 6), valid.reshape(-1, 8), strict=True)
    for pose, joints, ok in flat:
        alone = ik.puma560_ik(pose)
        torch.testing.assert_close(alone.q, joints, rtol=0, atol=1e-12)
        assert torch.equal(alone.valid, ok)


def test_large_batches_are_cut_without_a_trace():
    T = ik.forward_kinematics(PUMA, configurations(40_000))
    whole, first, last = ik.puma560_ik(T), ik.puma560_ik(T[:100]), ik.puma560_ik(T[-100:])
    torch.testing.assert_close(whole.q[:100], first.q, rtol=0, atol=1e-12)
    torch.testing.assert_close(whole.q[-100:], last.q, rtol=0, atol=1e-12)


@pytest.mark.parametrize("limits", [True, False])
def test_the_kernel_and_torch_agree(limits: bool):
    T = torch.cat([ik.forward_kinematics(PUMA, configurations(3000, seed=12)), edge_poses()])
    compiled, plain = ik.puma560_ik(T, limits=limits), ik.puma560_ik(T.clone().requires_grad_(), limits=limits)
    assert not compiled.q.requires_grad
    assert plain.q.requires_grad
    assert float(turned(compiled.q - plain.q.detach()).max()) < 1e-7
    assert torch.equal(compiled.valid, plain.valid)
    assert torch.equal(compiled.singular, plain.singular)


@pytest.mark.parametrize("plain", [True, False])
def test_both_paths_return_to_the_pose(plain: bool):
    q = configurations(2000, seed=13)
    T = ik.forward_kinematics(PUMA, q).requires_grad_(plain)
    branches = ik.puma560_ik(T)
    assert max(worst_errors(branches, T.detach())) < 1e-9
    assert float(turned(branches.q.detach() - q[:, None]).where(branches.valid, math.inf).amin(dim=1).max()) < 1e-6


def test_float32_stays_float32():
    T = ik.forward_kinematics(PUMA, configurations(5000, seed=3))
    branches = ik.puma560_ik(T.float(), limits=False)
    assert branches.q.dtype == torch.float32
    assert float(branches.valid.double().mean()) > 0.999
    position, rotation = worst_errors(branches, T)
    assert position < 2e-3  # the square of a rounded distance, under a root: sqrt(2e-6 m^2) at a fold of the arm
    assert rotation < 1e-5
    typical = ik.pose_error(ik.forward_kinematics(PUMA, branches.q.double()), T[:, None]).norm(dim=-1).median()
    assert float(typical) < 2e-6


# --- gradients ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [True, False])
def test_gradcheck_on_all_branches(limits: bool):
    q = torch.tensor([[0.3, -0.5, 1.0, 0.2, 0.8, -0.4], [-1.2, 0.2, 2.5, -1.0, -0.9, 2.0]], dtype=torch.float64)
    T = ik.forward_kinematics(PUMA, q).requires_grad_()
    assert torch.autograd.gradcheck(lambda T: ik.puma560_ik(T, limits=limits).q, T)


def test_the_gradient_is_that_of_the_implicit_function_theorem():
    q = configurations(5, seed=4)
    grads = []
    for solver in (None, ik.Puma560ClosedForm()):
        T = ik.forward_kinematics(PUMA, q).requires_grad_()
        answer = ik.solve_ik(PUMA, T, q0=q, solver=solver).q
        grads.append(torch.autograd.grad(answer.sin().sum(), T)[0])
    torch.testing.assert_close(grads[0], grads[1], rtol=1e-5, atol=1e-5)


def edge_poses() -> torch.Tensor:
    """Out of reach, on the first axis, at the shoulder, wrist straight, arm straight, NaN, no rotation."""
    T = ik.forward_kinematics(PUMA, configurations(1).expand(8, 6)).clone()
    T[0, :3, 3] = torch.tensor([5.0, 0, 0])
    T[1, :3, 3] = torch.tensor([0, 0, 1.0])
    T[2, :3, 3] = torch.tensor([0, D2, Z0])
    straight = torch.tensor([0.1, -0.2, 0.5, 0.3, 0.0, 0.4], dtype=torch.float64)
    T[3] = ik.forward_kinematics(PUMA, straight)
    straight[2], straight[4] = math.atan2(D4, A3), 1.0
    T[4] = ik.forward_kinematics(PUMA, straight)
    T[5, 0, 0] = math.nan
    T[6, :3, 2] *= -1
    T[7, :3, 3] = 0
    return T


def test_edges_have_finite_joints_and_gradients_and_touch_no_other_row():
    T = torch.cat([edge_poses(), ik.forward_kinematics(PUMA, configurations(1))]).requires_grad_()
    q, valid = ik.puma560_ik(T, limits=False)
    assert bool(q.isfinite().all())
    assert valid.any(dim=-1).tolist() == [False, False, False, True, True, False, False, False, True]
    assert bool((valid.all(dim=-1) == valid.any(dim=-1)).all())
    gradient = torch.autograd.grad(q.sin().sum(), T)[0]
    assert bool(gradient.isfinite().all())
    alone = T[-1:].detach().requires_grad_()
    expected = torch.autograd.grad(ik.puma560_ik(alone, limits=False).q.sin().sum(), alone)[0]
    torch.testing.assert_close(gradient[-1:], expected)
    assert max(worst_errors(ik.puma560_ik(T.detach()[3:5], limits=False), T.detach()[3:5])) < 1e-9


@pytest.mark.parametrize("angle", [0.0, math.pi, 1e-13, 1e-9, -1e-7, 1e-5])
def test_a_singular_wrist_is_exact_and_flagged(angle: float):
    q = configurations(200, seed=5)
    q[:, 4] = angle
    T = ik.forward_kinematics(PUMA, q)
    plain = ik.puma560_ik(T.clone().requires_grad_(), limits=False)
    assert max(worst_errors(plain, T)) < 1e-9
    branches = ik.puma560_ik(T, limits=False)
    assert max(worst_errors(branches, T)) < 1e-9
    original = branches.singular[turned((branches.q - q[:, None])[..., :3]) < 1e-6]
    assert bool((original == (abs(math.sin(angle)) < 1e-10)).all())
    flagged = branches.q[..., ::2, 3][branches.singular[..., ::2]]
    assert bool((flagged == 0).all())


def test_joints_are_wrapped_where_that_helps_then_masked():
    q = torch.deg2rad(torch.tensor([10.0, -200, 200, 20, 30, 40], dtype=torch.float64))
    T = ik.forward_kinematics(PUMA, q)
    wrapped, free = ik.puma560_ik(T), ik.puma560_ik(T, limits=False)
    assert float((wrapped.q[wrapped.valid] - q).abs().amax(dim=-1).min()) < 1e-9
    assert float((free.q - q).abs().amax(dim=-1).min()) > 1  # 200 degrees is -160 there
    assert bool(free.valid.all())
    assert 0 < int(wrapped.valid.sum()) < 8


# --- the solver ---------------------------------------------------------------------------------------------------


def test_solve_ik_returns_the_branch_next_to_the_start():
    q = configurations(2000, seed=6)
    T = ik.forward_kinematics(PUMA, q)
    solution = ik.solve_ik(PUMA, T, q0=q, solver=ik.Puma560ClosedForm())
    assert bool(solution.success.all())
    assert set(solution.steps.tolist()) == {1}
    assert float((solution.q - q).abs().max()) < 1e-6
    assert bool(ik.solve_ik(PUMA, T, solver=ik.Puma560ClosedForm()).success.all())


def test_it_agrees_with_levenberg_marquardt():
    q = configurations(1000, seed=7)
    T = ik.forward_kinematics(PUMA, q)
    iterated = ik.solve_ik(PUMA, T, tol_pos=1e-10, tol_rot=1e-10)
    assert float(iterated.success.double().mean()) > 0.995
    distance = turned(ik.puma560_ik(T).q - iterated.q[:, None]).amin(dim=1)
    assert float(distance[iterated.success].max()) < 1e-5  # ill-conditioned rows near th5 = 0 or a fold
    assert float(distance[iterated.success].median()) < 1e-9


def test_eight_solutions_are_the_branches():
    q = configurations(50, seed=8)
    T = ik.forward_kinematics(PUMA, q)
    solution = ik.solve_ik(PUMA, T, q0=q, solutions=8, limits=False, solver=ik.Puma560ClosedForm())
    assert bool(solution.success.all())
    assert float((solution.q[:, 0] - q).abs().max()) < 1e-6
    inside = ik.solve_ik(PUMA, T, q0=q, solutions=9, solver=ik.Puma560ClosedForm())
    assert torch.equal(inside.success.sum(dim=1), ik.puma560_ik(T).valid.sum(dim=1))
    assert not bool(inside.success[:, 8].any())


def test_a_singular_wrist_stays_as_it_is_in_q0():
    q = configurations(50, seed=9)
    q[:, 4] = 0
    solution = ik.solve_ik(PUMA, ik.forward_kinematics(PUMA, q), q0=q, solver=ik.Puma560ClosedForm())
    assert bool(solution.success.all())
    assert float((solution.q - q).abs().max()) < 1e-6


def test_failures_have_their_reason():
    T = edge_poses()
    anywhere = 2 * math.pi * torch.rand(100, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    reachable = ik.forward_kinematics(PUMA, anywhere)
    T[4] = reachable[~ik.puma560_ik(reachable).valid.any(dim=-1)][0]
    solution = ik.solve_ik(PUMA, T, solver=ik.Puma560ClosedForm())
    assert solution.reason.tolist() == [
        *["unreachable"] * 3, "converged", "joint_limits", *["invalid_target"] * 2, "unreachable"
    ]  # fmt: skip
    assert bool(solution.q.isfinite().all())


def test_tools_and_other_link_frames_are_no_obstacle():
    tool = torch.eye(4, dtype=torch.float64)
    tool[:3, 3] = torch.tensor([0.1, -0.05, 0.2])
    tool[:2, :2] = torch.tensor([[0.6, -0.8], [0.8, 0.6]])
    craig = [dict(d=Z0), dict(alpha=-math.pi / 2), dict(a=A2, d=D2), dict(a=A3, alpha=math.pi / 2, d=D4)]
    craig += [dict(alpha=-math.pi / 2), dict(alpha=math.pi / 2)]
    for robot in (PUMA.with_tool(tool), ik.Robot.from_dh(craig, convention="modified")):
        q = configurations(50, seed=10)
        T = ik.forward_kinematics(robot, q)
        solution = ik.solve_ik(robot, T, q0=q, solver=ik.Puma560ClosedForm())
        assert bool(solution.success.all())
        assert float((solution.q - q).abs().max()) < 1e-6


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: ik.puma560_ik(torch.zeros(3, 4)), ik.ShapeError, r"T must have shape \(..., 4, 4\), got \(3, 4\)"),
        (lambda: ik.puma560_ik("pose"), ik.ShapeError, "T must be a floating-point tensor, got str"),
        (lambda: ask("ur5e"), ik.ConfigError, "Puma560ClosedForm: robot 'ur5e' has not the joint axes of the built-in"),
        (lambda: ask("panda"), ik.ConfigError, "Puma560ClosedForm: robot 'panda' has not the joint axes"),
        (lambda: ask("puma560", mask=(1, 1, 1, 0, 0, 0)), ik.ConfigError, "solves whole poses; leave the mask out"),
    ],
)
def test_mistakes_are_refused(call, error: type, text: str):
    with pytest.raises(error, match=text):
        call()


def ask(name: str, **options) -> ik.IKSolution:
    return ik.solve_ik(ik.load_robot(name), torch.eye(4), solver=ik.Puma560ClosedForm(), **options)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_the_gpu_gives_the_same_branches(dtype: torch.dtype):
    T = ik.forward_kinematics(PUMA, configurations(5000, seed=11)).to(dtype)
    here, there = ik.puma560_ik(T), ik.puma560_ik(T.cuda())
    assert there.q.is_cuda
    assert there.q.dtype == dtype
    tolerance = 1e-6 if dtype == torch.float64 else 5e-2  # float32 near a fold
    assert float(turned(there.q.cpu() - here.q).max()) < tolerance
    assert float((there.valid.cpu() == here.valid).double().mean()) > 0.999
    assert bool(ik.solve_ik(PUMA, T.cuda(), tol_pos=1e-3, tol_rot=1e-3, solver=ik.Puma560ClosedForm()).success.all())
