"""The trajectory study and its command: points, patterns, networks in small, links, spheres, errata, mistakes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from support import without_times

import ikgrad as ik
from ikgrad.cli.main import main
from ikgrad.cli.reproduce.trajectory import FILES
from ikgrad.collision import link_segments
from ikgrad.config import TrajectoryConfig, load_config
from ikgrad.papers.store import load_study
from ikgrad.papers.trajectory import arm, curves, patterns
from ikgrad.papers.trajectory.errata import hidden_delta_error, printed_matrix, thresholds
from ikgrad.papers.trajectory.matrix import matrix_434
from ikgrad.papers.trajectory.networks import RULES, Ensemble, fit
from ikgrad.papers.trajectory.obstacle import LinkResult, meets, obstacle, random_spheres, verdicts
from ikgrad.papers.trajectory.report import report
from ikgrad.papers.trajectory.spheres import sphere_test
from ikgrad.papers.trajectory.study import TrajectoryStudy, run_study
from ikgrad.resources import builtin_file

QUICK = TrajectoryConfig(seeds=2, epochs=40, joint_epochs=20, lm_epochs=10, joint_lm_epochs=8, segments=20_000)


class Run(NamedTuple):
    study: TrajectoryStudy
    calls: list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def run() -> Run:
    calls: list[tuple[str, int, int]] = []
    return Run(run_study(QUICK, progress=lambda *call: calls.append(call)), calls)


@pytest.fixture
def study(run: Run) -> TrajectoryStudy:
    return run.study


def test_the_printed_points_are_met_but_for_one_coordinate():
    rows = arm.check_points()
    assert [row.name for row in rows] == ["via_1", "via_2", "destination_1", "destination_2"]
    assert max(row.off for row in rows) < 0.005
    assert [row.printed_off > 0.005 for row in rows] == [False, False, False, True]
    assert rows[3].printed_off == pytest.approx(3.0, abs=0.005)


def test_lengths_fitted_to_our_own_positions_would_be_ten():
    """The system of the fit is that of forward kinematics: exact positions give exact lengths."""
    assert arm.fitted_lengths() == pytest.approx((10.0, 10.0, 10.0), abs=0.01)
    q = arm.point("via_1")
    ends = arm.links_through(arm.joint_places(q))
    assert torch.allclose((ends[:, 1] - ends[:, 0]).sum(0), ik.forward_kinematics(arm.arm(), q)[:3, 3], atol=1e-12)


def test_links_through_true_places_are_the_links_of_the_arm():
    q = ik.sample_configurations(arm.arm(), 20, seed=0).double()
    torch.testing.assert_close(arm.links_through(arm.joint_places(q)), link_segments(arm.arm(), q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("tf", [7.0, 8.0, 10.0])
def test_the_curves_keep_their_conditions(tf: float):
    for row in curves.check_curves(tf):
        assert row.residual < 1e-9
        assert row.vias < 1e-9
        assert max(row.velocity_jump, row.acceleration_jump) < 1e-8
        assert max(row.hand_off) < 0.005
        assert row.lowest_deg > -1.0
        assert row.highest_deg < 80.0


def test_the_curves_are_scipys_and_a_wrong_one_would_be_seen(monkeypatch: pytest.MonkeyPatch):
    found = curves.scipy_difference(8.0)
    assert found is not None
    assert found < 1e-9
    right = curves.left_side_434
    monkeypatch.setattr(curves, "left_side_434", lambda points: 1.001 * right(points))
    wrong = curves.scipy_difference(8.0)
    assert wrong is not None
    assert wrong > 1e-3


def test_without_scipy_there_is_no_comparison(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(curves.importlib.util, "find_spec", lambda name: None)
    assert curves.scipy_difference(8.0) is None


def test_patterns_of_the_hand_know_the_destination_and_those_of_the_joints_the_present_angles():
    destinations = patterns.random_destinations(3, seed=1)
    q = arm.trajectories(destinations, 8.0).position(torch.linspace(0, 8, 5, dtype=torch.float64))
    hand, third, fourth = (patterns.along(destinations, target, 8.0, 5) for target in ("hand", "joint 3", "joint 4"))
    assert [p.x.shape for p in (hand, third, fourth)] == [(3, 5, 5), (3, 5, 3), (3, 5, 4)]
    for p in (hand, third, fourth):
        assert p.x[0, :, 0].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert torch.equal(hand.x[:, 2, 1:], destinations.rad2deg())
    torch.testing.assert_close(fourth.x[..., 1:], q[..., :3].rad2deg())
    torch.testing.assert_close(hand.y, ik.forward_kinematics(arm.arm(), q)[..., :3, 3])
    torch.testing.assert_close(third.y.norm(dim=-1), torch.full((3, 5), 10.0, dtype=torch.float64))
    with pytest.raises(ik.UnknownNameError, match="joint 5"):
        patterns.along(destinations, "joint 5", 8.0, 5)


def test_destinations_are_in_the_box_differ_by_seed_and_are_not_the_printed_ones():
    drawn = patterns.random_destinations(500, seed=0).rad2deg()
    low, high = torch.tensor(patterns.LOW_DEG), torch.tensor(patterns.HIGH_DEG)
    assert bool(((drawn >= low) & (drawn <= high)).all())
    assert torch.equal(drawn, patterns.random_destinations(500, seed=0).rad2deg())
    assert not torch.equal(drawn, patterns.random_destinations(500, seed=1).rad2deg())
    apart = (drawn[:, None] - arm.printed_destinations().rad2deg()).abs().amax(-1)
    assert float(apart.min()) > 0.1


def test_a_scale_takes_every_data_set_by_itself_and_back():
    x = torch.tensor([[[0.0, 5.0], [2.0, 7.0]], [[1.0, 0.0], [3.0, 9.0]]])
    scale = fit(x, torch.tensor([-1.0, 0.0]), torch.tensor([1.0, 1.0]))
    assert scale(x).tolist() == [[[-1.0, 0.0], [1.0, 1.0]]] * 2
    assert torch.allclose(scale.inverse(scale(x)), x)
    wide = fit(x, torch.tensor([0.0, 0.0]), torch.tensor([1.0, 1.0]), margin=2.0)
    assert wide(x)[0, :, 0].tolist() == pytest.approx([2 / 6, 4 / 6])


@pytest.mark.parametrize("rule", RULES)
def test_a_seed_learns_the_same_alone_as_beside_others(rule: str):
    small = TrajectoryConfig(seeds=1, destinations=4, hidden=5, epochs=5, lm_epochs=3)
    stacked = TrajectoryConfig(seeds=3, destinations=4, hidden=5, epochs=5, lm_epochs=3)
    alone = Ensemble("hand", rule, small).run()  # type: ignore[arg-type]
    beside = Ensemble("hand", rule, stacked).run()  # type: ignore[arg-type]
    torch.testing.assert_close(alone.answers[0], beside.answers[0], rtol=0, atol=1e-9)
    assert float((beside.answers[1] - beside.answers[0]).abs().max()) > 1e-3


def test_the_rate_falls_for_the_last_fifth():
    ensemble = Ensemble("joint 3", "per-pattern", QUICK)
    result = ensemble.run()
    assert ensemble.training.optimizer.param_groups[0]["lr"] == pytest.approx(QUICK.lr / 10)
    assert (result.epochs, result.patterns) == (QUICK.joint_epochs, 60 * 41)


def test_joint_3_is_learnt_in_a_second():
    result = Ensemble("joint 3", "Levenberg-Marquardt", TrajectoryConfig(seeds=2, joint_lm_epochs=25)).run()
    assert float(result.worst.max()) < 0.1
    assert float(result.train_max.max()) < 0.2


def test_the_hidden_delta_needs_all_outputs():
    one, three = hidden_delta_error()
    assert one > 0.1
    assert three < 1e-12


def test_thresholds_want_training():
    fixed, trained = thresholds(TrajectoryConfig(seeds=2, destinations=10))
    assert fixed > 2 * trained


def test_the_table_of_the_matrix_is_the_matrix():
    assert torch.equal(printed_matrix({"ta": 2.0, "tab": 3.0, "tc": 3.0}), matrix_434(2.0, 5.0, 8.0))


def test_the_sphere_test_finds_the_printed_form_wrong_and_the_corrected_right():
    found = sphere_test(300_000, seed=3)  # more than one chunk
    assert found.segments == 300_000
    assert (found.wrong, found.lines_wrong) == (0, 0)
    assert 0 < found.touching < found.lines < found.segments
    assert found.lines_wrong_printed > 30_000
    assert found.heights_wrong > 30_000
    assert sphere_test(1000, seed=1) != sphere_test(1000, seed=2)


def true_links(offset: float) -> LinkResult:
    """Links that are off by the same vector everywhere, two seeds."""
    t = torch.linspace(0, 8, patterns.TEST_INSTANTS, dtype=torch.float64)
    truth = link_segments(arm.arm(), arm.trajectories(arm.printed_destinations(), 8.0).position(t))
    off = torch.tensor([offset, 0.0, 0.0], dtype=torch.float64)
    return LinkResult("per-pattern", truth, torch.stack([truth, truth + off]), shown=0)


def test_perfect_links_get_the_true_verdicts():
    rows = verdicts(true_links(0.0), 8.0)
    assert [row.proof for row in rows] == ["touches", "free"]
    assert [row.differing for row in rows] == [0, 0]
    assert [row.true_count == row.predicted_count > 0 for row in rows] == [True, False]
    assert all(row.seeds_agreeing == 2 for row in rows)
    assert rows[0].contact < float("inf") == rows[1].contact
    assert rows[0].true_clearance < 0 < rows[1].true_clearance
    random = random_spheres(true_links(0.0))
    assert (random.missed, random.false, random.farthest) == (0, 0, 0.0)
    assert 0 < random.touching < random.verdicts


def test_wrong_links_are_judged_wrong_and_no_farther_than_they_are_off():
    links = true_links(0.4)
    assert links.worst.tolist() == [[0.0] * 3, [pytest.approx(0.4)] * 3]
    random = random_spheres(links)
    assert random.missed > 0
    assert random.false > 0
    assert 0.2 < random.farthest <= 0.4 + 1e-9
    assert random.grown == pytest.approx(0.41)
    assert random.missed_grown == 0
    assert random.false_grown > random.false
    assert float(links.lengths.min()) == pytest.approx(10.0)


def test_the_obstacle_is_met_exactly_where_the_distance_says_so():
    links = true_links(0.0)
    distance = obstacle().distance(links.truth)[..., 0]
    assert torch.equal(meets(links.truth), distance <= 0)


def test_the_study_joins_the_networks_answers_to_links(study: TrajectoryStudy):
    for rule in RULES:
        links, hands = study.links[rule], study.networks[rule]["hand"]
        assert torch.equal(links.predicted[..., 2, 1, :], hands.answers)
        assert torch.equal(links.predicted[..., 2, 0, :], study.networks[rule]["joint 4"].answers)
        assert torch.equal(links.predicted[..., 0, 1, :], study.networks[rule]["joint 3"].answers)
        assert links.shown == hands.median_seed
        assert torch.equal(hands.errors, hands.answers - patterns.unseen("hand", 8.0).y)


def test_claims_on_errors_wait_for_full_epochs(study: TrajectoryStudy):
    claims = [check.claim for check in study.checks]
    assert not any("unseen destinations" in claim or "random spheres" in claim for claim in claims)
    assert len(claims) == 8
    assert all(check.holds for check in study.checks)


def test_errata_are_numbered_with_evidence(study: TrajectoryStudy):
    assert [erratum.number for erratum in study.errata] == list(range(1, 12))
    assert all(erratum.evidence for erratum in study.errata)
    evidence = {erratum.number: erratum.evidence for erratum in study.errata}
    assert "13.6656" in evidence[1]
    assert "9.993, 10.006, 9.999" in evidence[2]
    assert "7 and 73 deg" in evidence[3]
    assert "3.41e+09" in evidence[4]
    assert "-1 and 0" in evidence[8]


def test_tables_say_that_table_1_is_lost_and_show_ours(study: TrajectoryStudy):
    tables = report(study)
    for table in tables:
        assert all(len(row) == len(table.columns) for row in table.rows), table.title
    ours = [table for table in tables if table.title.startswith("Table 1, destination")]
    assert len(ours) == 2
    assert all("its body is lost" in table.title for table in ours)
    assert ours[1].rows[-1][0] == "8.0"
    assert "(7.89, 13.67, 24.06)" in ours[1].rows[-1][2]


def test_progress_counts_all_work(run: Run):
    done = [call[1] for call in run.calls]
    assert run.calls[-1][1] == run.calls[-1][2]
    assert done == sorted(done)


def test_the_command_repeats_the_study_and_writes_its_files(
    study: TrajectoryStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    settings, out = tmp_path / "quick.yaml", tmp_path / "out"
    settings.write_text("seeds: 5\nepochs: 900\njoint_epochs: 20\nlm_epochs: 10\njoint_lm_epochs: 8\nsegments: 20000\n")
    command = ["reproduce", "trajectory", "--config", str(settings), "--seeds", "2", "--epochs", "40"]
    command += ["--out", str(out)]
    assert main([*command, "--json"]) == 0
    ours = json.loads(capsys.readouterr().out)
    assert without_times(ours) == without_times(json.loads(json.dumps(study.to_json())))
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert load_study(out / "trajectory_study.npz").to_json() == json.loads((out / "trajectory.json").read_text())
    assert main(command) == 2
    assert "exists already; it is overwritten with --force only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seeds", "0"], "at least 1"),
        (["--epochs", "-3"], "at least 1"),
        (["--config", "{tmp}/missing.yaml"], "cannot read the configuration"),
        (["--config", "{tmp}/bad.yaml"], "unknown key 'hiden'; did you mean 'hidden'?"),
        (["--config", "{tmp}/early.yaml"], "tf must come after the second via at 5 s, got 5"),
        (["--config", "{tmp}/margin.yaml"], "margin must not be negative, got -1"),
        (["--out", "{tmp}/no/where"], "does not exist; create it first"),
    ],
)
def test_mistakes_are_explained(options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "bad.yaml").write_text("hiden: 3\n")
    (tmp_path / "early.yaml").write_text("tf: 5\n")
    (tmp_path / "margin.yaml").write_text("margin: -1\n")
    assert main(["reproduce", "trajectory", *(option.format(tmp=tmp_path) for option in options)]) == 2
    assert message in capsys.readouterr().err


def test_the_configuration_file_holds_the_defaults():
    assert load_config(TrajectoryConfig, builtin_file("configs", "trajectory")) == TrajectoryConfig()


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "bar"), [("per-pattern", 0.3), ("Levenberg-Marquardt", 0.15)])
def test_five_seeds_keep_the_bar_on_both_unseen_destinations(rule: str, bar: float):
    result = Ensemble("hand", rule, TrajectoryConfig()).run()  # type: ignore[arg-type]
    assert float(result.worst.max()) <= bar
