"""The PUMA 560 study on few epochs: tables, stacks, checkpoints; the claims on errors have a slow test."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ikgrad.config import PumaConfig, RuleConfig
from ikgrad.errors import DataError
from ikgrad.networks import MLP
from ikgrad.papers.printed import read_table
from ikgrad.papers.puma.beyond import CONTENDERS, four_joint_arm, nine_poses, puma_branch, run_races
from ikgrad.papers.puma.figures import FIGURES
from ikgrad.papers.puma.path import check_path, path_data
from ikgrad.papers.puma.printed_results import printed_cases
from ikgrad.papers.puma.report import report
from ikgrad.papers.puma.study import PumaStudy, run_study
from ikgrad.papers.puma.training import Stack, paper_rules, stacks
from ikgrad.solvers.puma560 import puma560_ik


@pytest.fixture(scope="module")
def study() -> PumaStudy:
    return run_study(PumaConfig(epochs=300, seeds=3, literal_epochs=500))


def test_the_corrected_path_agrees_with_forward_kinematics_and_the_printed_one_is_flagged():
    rows = check_path()
    assert max(abs(value) for row in rows for value in row.corrected_residual_mm) <= 0.08
    assert all(abs(row.corrected_sum_deg - 180.0) <= 0.0151 for row in rows)
    assert [row.row for row in rows if not row.right] == [2, 3, 6, 9]
    assert [bool(row.changes) for row in rows] == [not row.right for row in rows]
    assert max(map(abs, rows[5].residual_mm)) > 500.0  # row 6 as printed is off by 0.85 m


def test_the_corrections_are_the_only_differences_between_the_two_paths():
    printed, corrected = path_data("printed"), path_data("corrected")
    assert int((printed.p != corrected.p).sum()) == 2
    assert int((printed.q != corrected.q).sum()) == 3


def test_errors_of_the_printed_tables_to_six_decimals():
    for case, row in zip(printed_cases(), read_table("puma_recomputed_errors"), strict=True):
        assert case.name == row["algorithm"]
        assert f"{case.rms_deg:.6f}" == row["rms_all_deg"]
        assert f"{case.max_deg:.6f}" == row["max_abs_deg"]
        assert [f"{value:.6f}" for value in case.joint_rms_deg] == [row[f"rms_theta{k}_deg"] for k in range(1, 7)]


def test_table_3_is_a_copy_of_table_2():
    assert {case.name: case.copy_of for case in printed_cases()} == {
        "OBP": "",
        "OBPR": "OBP",
        "BBP": "",
        "DBD": "",
        "QP": "",
    }


def test_no_printed_answer_leaves_its_range():
    for case in printed_cases():
        assert (case.answers_deg >= case.low_deg).all()
        assert (case.answers_deg <= case.high_deg).all()


def test_the_five_rules_are_those_of_table_7():
    for rule, row in zip(paper_rules(), read_table("puma_table7"), strict=True):
        assert rule.name == row["nn_type"]
        assert rule.lr == float(row["eta"])
        assert rule.momentum == float(row["mu_as_printed"])
        sizes = (3, *rule.hidden, 6)
        assert sizes == (int(row["n_I"]), int(row["n_H"]), int(row["n_O"]))
        assert (rule.activation, rule.output) == ("logistic", "logistic")


@pytest.mark.parametrize(
    ("case", "data", "seed"), [("OBP", "printed", 1), ("OBPR", "corrected", 2), ("BBP", "printed", 0)]
)
def test_a_stack_holds_the_networks_that_one_would_train_alone(study: PumaStudy, case: str, data: str, seed: int):
    """Written out once more without the study's own classes, from the data to the error in degrees."""
    found = next(c for c in study.cases if c.rule.name == case and c.data == data)
    path = path_data(data)
    low, span = path.q.amin(0), path.q.amax(0) - path.q.amin(0)
    x = (path.p - path.p.amin(0)) / (path.p.amax(0) - path.p.amin(0))
    y = torch.where(span > 0.0, (path.q - low) / torch.where(span > 0.0, span, 1.0), 0.0)
    net = MLP((3, 10, 6), hidden="logistic", output="logistic", seeds=seed, bound=0.5)
    rule = torch.optim.SGD(net.parameters(), 0.05, momentum=0.5)
    generator = torch.Generator().manual_seed(10_000 + seed)
    for _ in range(300):
        random = torch.rand(9, dtype=torch.float64, generator=generator).argsort()
        order = random if case == "OBPR" else torch.arange(9)
        for batch in order.split(9 if case == "BBP" else 1):
            rule.zero_grad()
            (0.5 * (net(x[batch]) - y[batch]).square().sum()).backward()
            rule.step()
    error = (low + net(x).detach() * span - path.q).rad2deg()
    torch.testing.assert_close(found.errors_deg[seed], error, rtol=0.0, atol=1e-8)
    assert found.rms_deg[seed].item() == pytest.approx(error.square().mean().sqrt().item(), abs=1e-8)


def test_obp_and_obpr_share_a_stack():
    assert [stack.name for stack in stacks(paper_rules(), 2)] == ["OBP-OBPR", "BBP", "DBD", "QP"]


def test_checks_and_tables_of_a_short_run(study: PumaStudy):
    assert all(check.holds for check in study.checks)
    titles = " ".join(table.title for table in report(study))
    for part in (
        "Table 1",
        "Table 2, OBP",
        "copy of OBP's",
        "Table 6, QP",
        "Table 7",
        "Table 8",
        "Ranking",
        "Misprints",
    ):
        assert part in titles
    assert {erratum.where for erratum in study.errata} >= {"Table 1, row 6", "Table 8", "eq. (58)"}


def test_every_row_of_every_table_fits_its_columns(study: PumaStudy):
    for table in report(study):
        assert all(len(row) == len(table.columns) for row in table.rows), table.title


def test_eq_58_as_printed_diverges(study: PumaStudy):
    assert ((study.literal.diverged_at > 0) | (study.literal.rms_deg > 20.0)).all()


def test_figures(study: PumaStudy):
    for name, draw in FIGURES.items():
        assert draw(study).axes, name


def test_json_holds_every_case(study: PumaStudy):
    document = study.to_json()
    assert len(document["cases"]) == 10
    assert len(document["cases"][0]["rms_deg"]) == 3
    assert document["config"]["rules"][3]["kappa"] == 0.01


def test_other_networks_by_configuration():
    rule = RuleConfig(name="deep", hidden=(4, 3), activation="tanh", output="linear", low=-1.0, order="batch", lr=0.01)
    stack = Stack([rule], 2)
    stack.run(50)
    assert stack.network.sizes == (3, 4, 3, 6)
    assert all(result.rms_deg.isfinite().all() for result in stack.results())


@pytest.mark.parametrize("name", ["OBPR", "DBD", "QP"])
def test_a_stack_goes_on_from_its_checkpoint_to_the_same_bits(name: str, tmp_path, monkeypatch):
    monkeypatch.setattr("ikgrad.papers.resume.CHECKPOINT_EVERY", 0.0)
    rule = next(rule for rule in paper_rules() if rule.name == name)
    whole = Stack([rule], 2)
    whole.run(60)

    calls = 0

    def cut(steps: int) -> None:
        nonlocal calls
        calls += 1
        if calls == 23:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Stack([rule], 2).run(60, checkpoint=tmp_path / "c.ckpt", progress=cut)
    resumed = Stack([rule], 2)
    resumed.run(60, checkpoint=tmp_path / "c.ckpt")
    for a, b in zip(whole.results(), resumed.results(), strict=True):
        assert torch.equal(a.errors_deg, b.errors_deg)
        assert torch.equal(a.curve, b.curve)


def test_a_checkpoint_of_other_settings_is_refused(tmp_path):
    rule = paper_rules()[2]
    Stack([rule], 2).run(3, checkpoint=tmp_path / "c.ckpt")
    with pytest.raises(DataError, match=r"is of a run with seeds 2, not 3; --force starts anew"):
        Stack([rule], 3).run(3, checkpoint=tmp_path / "c.ckpt")
    with pytest.raises(DataError, match=r"is of a run with epochs 3, not 4"):
        Stack([rule], 2).run(4, checkpoint=tmp_path / "c.ckpt")
    with pytest.raises(DataError, match=r"is of a run with rules \["):
        Stack([dataclasses.replace(rule, lr=0.1)], 2).run(3, checkpoint=tmp_path / "c.ckpt")


def test_the_box_of_the_second_race_is_one_branch():
    problem = puma_branch()
    centre = torch.tensor([35.0, -45.0, 165.0, 0.0, 60.0, 35.0], dtype=torch.float64)
    q = (centre + 30.0 * (2.0 * torch.cat([problem.y, problem.test[1]]) - 1.0)).deg2rad()
    from ikgrad.kinematics import forward_kinematics
    from ikgrad.robot import load_robot

    branches, _ = puma560_ik(forward_kinematics(load_robot("puma560"), q))
    turns = (branches[:, 0] - q + torch.pi).remainder(2.0 * torch.pi) - torch.pi
    assert turns.abs().max() < 1e-9


def test_races_stop_at_the_error_or_when_time_is_up():
    races = run_races(seconds=0.15)
    assert [race.title[:3] for race in races] == ["(a)", "(b)", "(c)"]
    for race in races:
        assert [row.rule for row in race.rows] == [contender.name for contender in CONTENDERS]
        for row in race.rows:
            assert row.total_epochs >= 1
            assert (row.epochs is None) == (2 * row.reached <= row.seeds)
            assert row.epochs is None or row.epochs <= row.total_epochs * row.seeds


@pytest.mark.parametrize("problem", [nine_poses, puma_branch, four_joint_arm])
def test_problems_are_scaled(problem):
    made = problem()
    for data in (made.x, made.y):
        assert data.min() >= 0.0
        assert data.max() <= 1.0
    assert made.test[0].shape[-1] == made.x.shape[-1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_claims_on_errors():
    study = run_study(PumaConfig(seeds=8))
    assert len(study.checks) == 10
    assert all(check.holds for check in study.checks), study.checks
