"""The closed loop of the Denso study: paths, the loop itself, the remedies, and a study in small."""

from __future__ import annotations

import math

import pytest
import torch

import ikgrad as ik
from ikgrad.data import Cube, DataSet
from ikgrad.networks import MLP
from ikgrad.papers.denso import cure_report, remedies
from ikgrad.papers.denso.arm import HOME, denso, tool_down_ik
from ikgrad.papers.denso.candidates import Trained, work
from ikgrad.papers.denso.cure import Course, CureStudy, cure
from ikgrad.papers.denso.loop import closed_loop, gains, position
from ikgrad.papers.denso.networks import make_data
from ikgrad.papers.denso.paths import CENTRE, HALF_WIDTH, PATHS, TrainingPath, all_paths, down, path_points
from ikgrad.training.losses import joint

LAP = 60
HOME_POINT = torch.tensor(CENTRE, dtype=torch.float64)


@pytest.fixture(scope="module")
def data() -> list[DataSet]:
    return make_data([TrainingPath(seed=seed, count=LAP * 5, noise=0.02) for seed in (0, 1)])


def trained(data: list[DataSet], kind: type[ik.Inverter] = ik.Inverter, **settings: object) -> list[ik.Inverter]:
    inverters = remedies.make(kind, range(len(data)), 6)
    remedies.train(inverters, data, 12, **settings)  # type: ignore[arg-type]
    return inverters


@pytest.fixture(scope="module")
def inverters(data: list[DataSet]) -> list[ik.Inverter]:
    return trained(data)


@pytest.mark.parametrize("kind", PATHS)
@pytest.mark.parametrize("seed", [0, 7])
def test_paths_touch_the_faces_of_the_cube_and_can_be_reached(kind: str, seed: int):
    p = path_points(kind, seed=seed)
    away = (p - HOME_POINT).abs().amax(0)
    assert away.tolist() == pytest.approx([HALF_WIDTH] * 3, abs=1e-6)
    assert (away <= HALF_WIDTH + 1e-15).all()
    q = tool_down_ik(p)
    assert q.isfinite().all()
    assert (q - q.roll(1, 0)).abs().max() < math.radians(2.0)


@pytest.mark.parametrize("kind", PATHS)
def test_paths_are_closed_and_go_in_small_steps(kind: str):
    p = path_points(kind, lap=4000)
    step = (p - p.roll(1, 0)).norm(dim=-1)
    assert step.max() < 6e-4
    assert step.max() < 8 * step.mean()


def test_only_the_square_and_the_ends_of_the_helix_have_corners():
    for kind in PATHS:
        p = path_points(kind)
        bend = (p.roll(-1, 0) - 2 * p + p.roll(1, 0)).norm(dim=-1)
        sharp = int((bend > 5e-5).sum())
        assert sharp == {"square": 4, "helix": 2}.get(kind, 0), kind


def test_paths_start_where_they_should_and_depend_on_the_seed_only_where_they_say():
    assert torch.allclose(path_points("helix")[0], HOME_POINT + torch.tensor([0.0, 0.05, -0.05]), atol=1e-15)
    assert torch.allclose(path_points("square")[0], HOME_POINT + torch.tensor([-0.05, 0.0, -0.05]), atol=1e-15)
    assert torch.allclose(path_points("figure eight")[0], HOME_POINT, atol=1e-15)
    same = [bool(torch.equal(path_points(kind, seed=0), path_points(kind, seed=1))) for kind in PATHS]
    assert same == [True, True, True, False, False]
    with pytest.raises(ik.UnknownNameError, match=r"unknown path 'helx'.*helix"):
        path_points("helx")


def test_the_training_path_is_its_own_data():
    rows = make_data([TrainingPath(seed=3, count=LAP)])[0].samples
    assert torch.allclose(rows.T[:, :3, 3], path_points("training path", seed=3, lap=LAP), atol=1e-12)
    assert torch.equal(rows.q_current, rows.q.roll(1, 0))


def test_positions_by_table_1_are_those_of_the_robot():
    q = ik.sample_configurations(denso(), 50, seed=0)
    assert torch.allclose(position(q), ik.forward_kinematics(denso(), q)[:, :3, 3], atol=1e-12)


@pytest.mark.parametrize("corrections", [0, 1])
@pytest.mark.parametrize("kind", [ik.Inverter, remedies.StepInverter])
def test_the_closed_loop_is_a_naive_loop(data: list[DataSet], kind: type[ik.Inverter], corrections: int):
    loss = remedies.increment_loss if kind is remedies.StepInverter else joint
    nets = trained(data, kind, loss=loss)
    T = down(torch.stack([all_paths(seed, lap=LAP) for seed in (0, 1)]))
    start = tool_down_ik(T[:, :, -1, :3, 3])
    found = closed_loop(nets, T, start, ticks=LAP + 5, corrections=corrections)
    for s, net in enumerate(nets):
        for p in range(len(PATHS)):
            twice = torch.cat([T[s, p], T[s, p]])[: LAP + 5]
            with torch.no_grad():
                naive = net.rollout(twice, start[s, p], corrections=corrections)
            assert torch.allclose(found[:, s, p], naive, atol=1e-9)


def test_a_traditional_network_answers_the_same_wherever_the_arm_stands(data: list[DataSet]):
    nets = remedies.make(ik.Inverter, range(2), 6, feedback=False)
    remedies.train(nets, data, 3)
    T = down(torch.stack([all_paths(seed, lap=LAP) for seed in (0, 1)]))
    start = tool_down_ik(T[:, :, -1, :3, 3])
    found = closed_loop(nets, T, start + 1.0, ticks=LAP)
    assert torch.allclose(found[:, 1, 2], nets[1](T[1, 2]).detach(), atol=1e-12)
    assert gains(nets, T, start[:, :, None].expand(2, 5, LAP, 6)).max() == 0.0


def test_gains_are_spectral_radii_of_the_jacobian(inverters: list[ik.Inverter], data: list[DataSet]):
    T, _, q_current = (torch.stack([getattr(d.samples, name)[:7] for d in data]) for name in ("T", "q", "q_current"))
    found = gains(inverters, T, q_current)
    for s, inverter in enumerate(inverters):
        for k in range(7):
            J = torch.autograd.functional.jacobian(lambda q, s=s, k=k, i=inverter: i(T[s, k], q), q_current[s, k])
            moving = inverter.output_scale.span > 0
            J = J[moving][:, moving]
            assert found[s, k].item() == pytest.approx(torch.linalg.eigvals(J).abs().max().item(), rel=1e-9)


def test_a_correction_makes_the_error_of_a_network_much_smaller(inverters: list[ik.Inverter]):
    T = down(torch.stack([all_paths(seed, lap=4 * LAP) for seed in (0, 1)]))
    start = tool_down_ik(T[:, :, -1, :3, 3])
    wanted = T[..., :3, 3].movedim(2, 0)
    alone, corrected = (
        (position(closed_loop(inverters, T, start, ticks=4 * LAP, corrections=k)) - wanted).norm(dim=-1).amax()
        for k in (0, 1)
    )
    assert corrected < 0.1 * alone


def test_tangents_are_directional_derivatives():
    stack = MLP((5, 4, 3, 2), members=3, seeds=range(3))
    generator = torch.Generator().manual_seed(0)
    x, v = (torch.randn(3, 7, 5, dtype=torch.float64, generator=generator) for _ in range(2))
    answer, change = remedies.tangent(stack, x, v)
    expected = torch.autograd.functional.jvp(stack, x, v)
    assert torch.allclose(answer, expected[0], atol=1e-14)
    assert torch.allclose(change, expected[1], atol=1e-14)


@pytest.mark.parametrize("kind", [ik.Inverter, remedies.StepInverter])
def test_the_contraction_penalty_is_the_norm_of_the_jacobian(kind: type[ik.Inverter]):
    """Over 4,000 copies of one row, each with a direction of its own, the mean square is the Frobenius norm squared."""
    data = make_data([TrainingPath(count=300, noise=0.02)])
    inverter = remedies.make(kind, [0], 6)[0].fit(*data[0].train)
    stack = MLP(inverter.network.sizes, members=1)
    stack.load_state_dict({name: value[None] for name, value in inverter.network.state_dict().items()})
    T, q, q_current = (part[:1] for part in data[0].train)
    x = inverter.input_scale(inverter.features(T, q_current)).expand(1, 4000, -1)
    r = remedies.contraction(0.01)([inverter])(stack, x, inverter.output_scale(q).expand(1, 4000, -1))
    J = torch.autograd.functional.jacobian(lambda q: inverter(T[0], q), q_current[0])
    moving = inverter.input_scale.span[-6:] > 0
    expected = 0.01**2 * J[:, moving].square().sum()
    assert r.shape == (1, 4000, 12)
    assert r[..., 6:].square().sum(-1).mean().item() == pytest.approx(expected.item(), rel=0.05)
    assert torch.allclose(r[0, 0, :6], inverter(T, q_current)[0] - q[0], atol=1e-12)


def test_the_contraction_penalty_lowers_the_gain():
    data = make_data([Cube(home=HOME, count=400, half_width=0.03, nearest=0.0, farthest=0.002)])
    free = remedies.make(ik.Inverter, [0], 8)
    remedies.train(free, data, 15)
    held = remedies.make(ik.Inverter, [0], 8)
    remedies.train(held, data, 15, loss=remedies.contraction(0.02))
    T, _, q_current = data[0].test
    before, after = (gains(nets, T[None], q_current[None]).max() for nets in (free, held))
    assert after < 0.5 * before


def test_the_pose_loss_is_the_error_of_the_pose(inverters: list[ik.Inverter], data: list[DataSet]):
    stack = MLP(inverters[0].network.sizes, members=1)
    stack.load_state_dict({name: value[None] for name, value in inverters[0].network.state_dict().items()})
    T, q, q_current = data[0].test
    x = inverters[0].input_scale(inverters[0].features(T, q_current))[None]
    r = remedies.pose_loss(inverters[:1])(stack, x, inverters[0].output_scale(q)[None])
    found = ik.forward_kinematics(denso(), inverters[0](T, q_current))
    assert torch.allclose(r[0, :, :3].abs(), (found - T)[:, :3, 3].abs(), atol=1e-12)
    assert (r[0, :, 3:].norm(dim=-1) / 0.17 - ik.pose_error(found, T)[:, 3:].norm(dim=-1)).abs().max() < 1e-9


def test_rollouts_replace_half_of_the_present_joints_by_where_the_network_led(
    inverters: list[ik.Inverter], data: list[DataSet]
):
    new = remedies.add_rollouts(inverters, data, 1, seed=5)[0].samples
    old = data[0].samples
    changed = (new.q_current != old.q_current).any(-1)
    assert 0.3 < changed.double().mean() < 0.7
    assert torch.equal(new.T, old.T)
    answers = inverters[0](old.T, old.q.roll(1, 0)).detach().roll(1, 0)  # one tick, for the row that comes next
    assert torch.allclose(new.q_current[changed], answers[changed], atol=1e-12)


@pytest.fixture(scope="module")
def study() -> tuple[CureStudy, int]:
    calls: list[int] = []
    return cure(range(2), 2, 2, 50, count=calls.append), sum(calls)


def test_a_small_study_has_every_remedy_and_counts_its_epochs(study: tuple[CureStudy, int]):
    result, done = study
    assert done == work(2, 2, 2)
    assert [row.hidden for row in result.rows].count(0) == 1
    assert result.rows[result.best].remedy == "nearby points, more units"
    for row in result.rows:
        assert row.worst_mm.shape == (2, 5)
        assert row.worst_mm.isfinite().all()
    alone, corrected = (result.rows[k].worst_mm for k in (result.best, result.corrected))
    assert (corrected < alone).all()
    tables = cure_report.cure_tables(result)
    assert all(len(row) == len(table.columns) for table in tables for row in table.rows)
    assert not list(cure_report.check_cure(result))  # too short to be judged


def test_the_worst_error_of_a_row_is_that_of_its_loop():
    course = Course([0], 30, LAP)
    nets = remedies.make(ik.Inverter, [0], 5)
    remedies.train(nets, make_data([TrainingPath(count=200)]), 3)
    errors = course.errors_mm(nets)
    with torch.no_grad():
        q = nets[0].rollout(course.T[0, 3, :30], course.q[0, 3, -1])
    T = ik.forward_kinematics(denso(), q)
    expected = 1000 * (T[:, :3, 3] - course.points[0, 3, :30]).norm(dim=-1)
    assert torch.allclose(errors[:, 0, 3], expected, atol=1e-9)
    one_step = [(nets[0](T, q.roll(1, 0)) - q).square().mean() for T, q in zip(course.T[0], course.q[0], strict=True)]
    assert course.one_step(nets).item() == pytest.approx(torch.stack(one_step).mean().item())


@pytest.mark.slow
def test_the_recommended_network_keeps_to_all_paths_and_plain_scheme_b_does_not():
    """Three seeds of the ten."""
    made, course = Trained(range(3), 40, 80), Course(range(3), 20_000)
    plain, best = made.train(made.path(), 10), made.train(made.cube(0.002), 30, epochs=80)
    assert (course.errors_mm(best).amax((0, 2)) < 0.5).all()
    assert course.errors_mm(best, corrections=1).max() < 1e-3
    assert (course.errors_mm(plain).amax((0, 2)) > 0.5).all()
