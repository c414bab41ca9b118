"""Inverters from the present joints: shapes, limits, what they may not depend on, round trips and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.networks import IncrementInverter, ResidualMLP, UnrolledInverter
from ikgrad.solvers.damped import damped_steps

FAMILIES = [IncrementInverter, UnrolledInverter]
Family = type[IncrementInverter]


def small(family: Family, robot: ik.Robot, seed: int = 0) -> IncrementInverter:
    return family(robot, width=16, depth=2, seed=seed)


def loud(inverter: IncrementInverter) -> IncrementInverter:
    """A last layer that says a lot, so that limits and invariances are put to the test."""
    with torch.no_grad():
        inverter.network.layers[-1].weight.mul_(300.0)  # type: ignore[operator]
    return inverter


@pytest.fixture(params=FAMILIES, ids=lambda family: family.family)
def family(request: pytest.FixtureRequest) -> Family:
    return request.param


def test_answers_stay_inside_the_limits(family: Family, robot: ik.Robot):
    T, _, q_current = TaskStream(robot, batch_size=50).batch(0)
    inverter = loud(small(family, robot))
    q = inverter(T, q_current)
    assert bool(((q >= robot.q_min) & (q <= robot.q_max)).all())
    assert bool(q.isfinite().all())
    if robot.q_min.isfinite().any():
        raw = inverter.iterates(T, q_current)[-1]
        assert bool(((raw < robot.q_min) | (raw > robot.q_max)).any()), "nothing had to be clamped"


def test_rows_do_not_influence_each_other_and_any_batch_shape_goes(family: Family, panda: ik.Robot):
    T, _, q_current = TaskStream(panda, batch_size=6).batch(0)
    inverter = small(family, panda)
    whole = inverter(T, q_current)
    assert inverter(T.view(3, 1, 2, 4, 4), q_current.view(3, 1, 2, 7)).shape == (3, 1, 2, 7)
    torch.testing.assert_close(inverter(T[4], q_current[4]), whole[4], rtol=0, atol=1e-5)
    assert inverter(T, q_current[0]).shape == (6, 7)
    assert inverter(T.float(), q_current.float()).dtype == torch.float32
    assert inverter(T[:0], q_current[:0]).shape == (0, 7)


def test_answers_do_not_depend_on_where_the_base_stands(family: Family, panda: ik.Robot):
    T, _, q_current = TaskStream(panda, batch_size=20).batch(0)
    turned = q_current.clone()
    turned[:, 0] += 0.3  # joint 1 carries the whole arm about the base's z
    keep = (turned[:, 0] < panda.q_max[0] - 0.1) & (q_current[:, 0].abs() < 1.0)
    around = ik.forward_kinematics(panda, turned) @ torch.linalg.inv(ik.forward_kinematics(panda, q_current))
    before, after = damped_steps(panda, T, q_current), damped_steps(panda, around @ T, turned)
    torch.testing.assert_close(after.error[keep], before.error[keep], rtol=0, atol=1e-10)
    moved = ik.load_robot("panda").with_tool(torch.eye(4))
    assert torch.equal(small(family, moved)(T, q_current), small(family, panda)(T, q_current))


def test_large_and_small_arms_are_the_same_to_the_network(family: Family):
    rows = [{"theta": 0.1, "d": 0.1, "a": 0.3, "alpha": alpha} for alpha in (1.5, 0.2, -1.5, 0.7)]
    limits = dict(convention="standard", q_min=[-2.5] * 4, q_max=[2.5] * 4)
    robots = [
        ik.Robot.from_dh([row | {"d": s * row["d"], "a": s * row["a"]} for row in rows], **limits) for s in (1.0, 7.0)
    ]
    answers = []
    for robot in robots:
        T, _, q_current = TaskStream(robot, batch_size=30).batch(0)
        answers.append(loud(small(family, robot))(T, q_current))
    torch.testing.assert_close(*answers, rtol=0, atol=1e-3)


def test_an_untrained_inverter_hardly_moves_or_takes_the_plain_steps(panda: ik.Robot):
    T, _, q_current = TaskStream(panda, batch_size=100).batch(0)
    with torch.no_grad():
        assert float((IncrementInverter(panda)(T, q_current) - q_current).abs().max()) < 0.1
        unrolled = UnrolledInverter(panda, rounds=3)
        unrolled.network.layers[-1].weight.zero_()  # type: ignore[operator]
        plain = damped_steps(panda, T, q_current, steps=3).q
        torch.testing.assert_close(unrolled(T, q_current), plain, rtol=0, atol=1e-12)


def test_first_weights_depend_on_the_seed_alone(family: Family, panda: ik.Robot):
    first = small(family, panda, seed=5).state_dict()
    torch.manual_seed(1)
    again, other = small(family, panda, seed=5).state_dict(), small(family, panda, seed=6).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert any(not torch.equal(first[name], other[name]) for name in first)


def test_the_features_have_names(family: Family, robot: ik.Robot):
    inverter = small(family, robot)
    assert len(inverter.feature_names) == inverter.network.layers[0].in_features


def test_a_round_trip_gives_the_same_answers(family: Family, tmp_path: Path):
    robot = ik.load_robot("denso_vp6242")
    T, _, q_current = TaskStream(robot, batch_size=20).batch(0)
    inverter = loud(small(family, robot))
    again = ik.load_inverter(inverter.save(tmp_path / "mine"))
    assert type(again) is family
    assert torch.equal(again(T, q_current), inverter(T, q_current))
    assert json.loads((tmp_path / "mine" / "config.json").read_text())["family"] == family.family


def test_other_robots_other_families_and_damage_are_refused(family: Family, tmp_path: Path):
    folder = small(family, ik.load_robot("denso_vp6242")).save(tmp_path / "mine")
    with pytest.raises(
        ik.RobotError, match=r"these weights are for robot 'denso_vp6242' .* not for 'ur5e' .*joint names"
    ):
        ik.load_inverter(folder, robot=ik.load_robot("ur5e"))
    config = json.loads((folder / "config.json").read_text())
    for change, message in [
        ({"family": "oracle"}, "unknown family 'oracle' of inverters \\(known: classic, increment, unrolled\\)"),
        ({"family": "classic"}, "the metadata lack feedback"),
        ({"network": {**config["network"], "width": 17}}, "the weights do not fit the configuration"),
        ({"network": {"width": 16}}, "the metadata lack .*depth, activation"),
        ({"features": ["x"]}, "features of other names"),
        ({"weights_sha256": "0" * 64}, "the weights are truncated or were changed since they were saved"),
    ]:
        (folder / "config.json").write_text(json.dumps({**config, **change}))
        with pytest.raises(ik.DataError, match=message):
            ik.load_inverter(folder)


def test_folders_from_before_there_were_families_are_read(tmp_path: Path):
    robot = ik.load_robot("denso_vp6242")
    q = ik.sample_configurations(robot, 20, seed=0)
    T = ik.forward_kinematics(robot, q)
    folder = ik.Inverter(robot).fit(T, q).save(tmp_path / "old")
    config = json.loads((folder / "config.json").read_text())
    assert config.pop("family") == "classic"
    (folder / "config.json").write_text(json.dumps(config))
    assert isinstance(ik.load_inverter(folder), ik.Inverter)


def test_misuse_is_refused(panda: ik.Robot):
    inverter = small(UnrolledInverter, panda)
    T, q = torch.eye(4).double(), torch.zeros(7).double()
    with pytest.raises(ik.ShapeError, match=r"T must have shape \(\.\.\., 4, 4\), got \(3, 4\)"):
        inverter(T[:3], q)
    with pytest.raises(ik.ShapeError, match=r"q_current must have shape \(\.\.\., 7\) for robot 'panda', got \(6,\)"):
        inverter(T, q[:6])
    with pytest.raises(ik.ShapeError, match=r"T of shape \(2, 4, 4\) and q_current of shape \(3, 7\) do not fit"):
        inverter(T.expand(2, 4, 4), q.expand(3, 7))
    with pytest.raises(ik.ConfigError, match=r"rounds must be at least 1, got 0"):
        UnrolledInverter(panda, rounds=0)
    with pytest.raises(ik.ConfigError, match=r"damping must be positive, got 0\.0"):
        UnrolledInverter(panda, damping=0.0)
    with pytest.raises(ik.ShapeError, match="sizes must be at least 1, got 6 inputs, 7 outputs, 0 x 2"):
        ResidualMLP(6, 7, width=0, depth=2)
    with pytest.raises(ik.UnknownNameError, match="unknown activation 'geluu'; did you mean 'gelu'"):
        IncrementInverter(panda, activation="geluu")
