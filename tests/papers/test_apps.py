"""The KR 210 study against the paper, and against an independent recomputation (tests/golden)."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import ikgrad as ik
from ikgrad.config import AppsConfig
from ikgrad.papers.apps import compare
from ikgrad.papers.apps.descent import descend
from ikgrad.papers.apps.errata import printed_joints
from ikgrad.papers.apps.experiment import NAMES, goal_poses, round_joints, solve_motions, start_configuration
from ikgrad.papers.apps.report import report
from ikgrad.papers.apps.study import AppsStudy, run_study
from ikgrad.papers.apps.tables import all_tables, printed_position
from ikgrad.papers.printed import find_row, numbers

ITERATIONS = [438, 256, 316, 618, 278, 233, 281]  # Table 6
QUICK = AppsConfig(random_starts=40, random_max_steps=300, learning_rates=(1.0, 0.1), learning_rate_max_steps=700)


@pytest.fixture(scope="module")
def study() -> AppsStudy:
    return run_study(QUICK)


@pytest.fixture(scope="module")
def reference() -> list[dict[str, str]]:
    """Recomputed independently in float64, without PyTorch."""
    with (Path(__file__).parents[1] / "golden/apps_reference_run.csv").open() as file:
        return list(csv.DictReader(file))


def starts(study: AppsStudy) -> torch.Tensor:
    return torch.stack([motion.q_start for motion in study.motions])


def test_iterations_are_the_papers(study: AppsStudy):
    assert [row.iterations for row in study.tables.table6] == ITERATIONS
    assert [row.printed_iterations for row in study.tables.table6] == ITERATIONS
    assert all(motion.converged and motion.reason == "converged" for motion in study.motions)


def test_joint_values_are_those_of_table_3(study: AppsStudy):
    """2e-4 deg: the table has four decimals; theta_6 of I-1 was rounded to three (misprint 5)."""
    for row in study.tables.table3:
        for k, difference in enumerate(row.difference_deg):
            bar = 6e-4 if (row.motion, row.quantity, k) == ("I-1", "R_1", 5) else 2e-4
            assert abs(difference) <= (bar if row.quantity == "R_1" else 1e-9), (row.motion, row.quantity, k)


def test_joint_values_are_those_of_an_independent_run(study: AppsStudy, reference: list[dict[str, str]]):
    """1.1e-5 deg: the reference has five decimals, and both descents round differently."""
    for motion, row in zip(study.motions, reference, strict=True):
        for kind, q in (("raw", motion.path[-1]), ("wrapped", motion.q)):
            expected = torch.tensor(numbers(row, *(f"theta{k}_{kind}_deg" for k in range(1, 7)))).double()
            torch.testing.assert_close(q.rad2deg(), expected, atol=1.1e-5, rtol=0)
        assert float(motion.errors[-1]) / 2 == pytest.approx(float(row["E_final"]), rel=1e-3)


@pytest.mark.parametrize(("quantity", "bar_mm"), [("R_1", 0.02), ("R_2", 0.01)])
@pytest.mark.parametrize("motion", NAMES)
def test_fk_of_table_3_is_table_4(motion: str, quantity: str, bar_mm: float):
    """Table 4 is rounded to 0.01 mm; y of R_1 in 6-I is printed 0 and is 0.019 mm (misprint 10)."""
    T = ik.forward_kinematics(ik.load_robot("kr210"), printed_joints(motion, quantity))
    assert abs(T[:3, 3].numpy() - printed_position(motion, quantity)).max() * 1e3 <= bar_mm


def test_table_5_follows_from_table_4_to_the_last_digit(study: AppsStudy):
    for row in study.tables.table5:
        assert row.from_table4_mm == row.printed_mm, row.motion
        if row.motion != "6-I":
            assert row.ours_mm == row.printed_mm, row.motion


def test_table_5_of_motion_6_i_differs_because_table_4_prints_y_as_zero(study: AppsStudy):
    row = study.tables.table5[-1]
    assert row.printed_mm == (0.0, 0.05, 0.05)
    assert row.ours_mm == (0.01, 0.04, 0.05)
    assert max(abs(a - b) for a, b in zip(row.unrounded_mm, row.printed_mm, strict=True)) < 0.0151


def test_only_theta_4_of_the_last_motion_is_wrapped(study: AppsStudy):
    """Eq. (12): the descent ends at 360.1614 deg, beyond 350, and 360 is subtracted."""
    turns = torch.stack([((motion.path[-1] - motion.q).rad2deg() / 360) for motion in study.motions])
    expected = torch.zeros(7, 6, dtype=torch.float64)
    expected[6, 3] = 1
    torch.testing.assert_close(turns, expected, atol=1e-12, rtol=0)
    assert float(study.motions[6].path[-1, 3].rad2deg()) == pytest.approx(360.1614, abs=2e-4)


@pytest.mark.parametrize(("index", "name"), [(3, "3-4"), (6, "6-I")])
def test_joint_changes_are_those_of_the_text(study: AppsStudy, index: int, name: str):
    """The path taken, before eq. (12); 3e-4 deg: differences of two values of four decimals."""
    motion, row = study.motions[index], find_row("apps_text_joint_changes", motion=name)
    expected = numbers(row, *(f"d_theta{k}_deg" for k in range(1, 6)), "d_theta6_corrected_deg")
    change = (motion.path[-1] - motion.q_start).rad2deg().tolist()
    assert change == pytest.approx(expected, abs=3e-4)


def test_the_half_sum_with_twice_the_rate_is_the_same_descent(study: AppsStudy):
    half = ik.Apps(eta=0.2, E0=5e-10, half_sum=True)
    paths = descend(ik.load_robot("kr210"), goal_poses(ik.load_robot("kr210")), starts(study), half)
    assert [len(path) for path in paths] == ITERATIONS


def test_float32_counts_differ_by_at_most_one(study: AppsStudy):
    robot = ik.load_robot("kr210")
    single = robot.to(dtype=torch.float32)
    paths = descend(single, goal_poses(robot).float(), starts(study).float(), ik.Apps.reproduces())
    assert all(path.dtype == torch.float32 for path in paths)
    assert [len(path) for path in paths] == pytest.approx(ITERATIONS, abs=1)


def test_printed_settings_do_not_converge_within_1000_iterations(study: AppsStudy):
    assert [row.iterations for row in study.printed_settings] == [None] * 7
    assert {row.max_steps for row in study.printed_settings} == {1000}
    assert min(row.E_best for row in study.printed_settings) > 1e-5  # 2 E0 would be 2e-8


def test_equation_20_as_printed_stalls(study: AppsStudy):
    """No joint moves where |dtheta| is below the limit; at eta 0.01 four motions never begin."""
    literal = replace(ik.Apps.reproduces(), literal=True)
    rows = compare.descent_rows(study.motions, literal, (1.0, 0.5, 0.1, 0.05, 0.01))
    assert [row.iterations for row in rows] == [None] * 35
    assert min(row.E_best for row in rows) > 1e-3
    assert [row.motion for row in rows if not row.joints_moved] == ["1-2", "2-3", "4-5", "5-6"]
    assert {row.eta for row in rows if not row.joints_moved} == {0.01}


def test_newton_raphson_solves_every_motion(study: AppsStudy):
    for row in study.newton:
        assert row.iterations is not None, row.motion
        assert row.iterations <= 12, row.motion
        assert row.mae_mm < 1e-6, row.motion
    assert [row.printed_mae_mm for row in study.newton] == [None, 2.0, 1.4, 59.53, 0.83, None, 204.5]


def test_newton_raphson_with_a_tool_frame_error_solves_none(study: AppsStudy):
    assert [row.iterations for row in study.newton_tool_frame] == [None] * 7
    assert all(row.mae_mm > 0.01 for row in study.newton_tool_frame)


def test_a_learning_rate_of_one_never_converges_and_a_tenth_is_the_papers(study: AppsStudy):
    by_rate = {rate: [row.iterations for row in study.learning_rates if row.eta == rate] for rate in (1.0, 0.1)}
    assert by_rate == {1.0: [None] * 7, 0.1: ITERATIONS}
    for row, curve in zip(study.learning_rates, study.rate_curves, strict=True):
        assert len(curve) == (row.iterations or row.max_steps)
        assert float(curve[-1]) == row.E_final


def test_the_papers_learning_rate_is_just_below_the_stability_limit(study: AppsStudy):
    """An independent analysis of the Hessian gives 0.2034 (at P_I) to 0.2323 for the half sum: twice these."""
    assert min(study.stable_rates) == study.stable_rates[-1] == pytest.approx(0.2034 / 2, abs=5e-5)
    assert max(study.stable_rates) == pytest.approx(0.2323 / 2, abs=5e-5)


def test_random_starts_compare_all_methods(study: AppsStudy):
    rows = {row.method: row for row in study.random_starts}
    assert set(rows) == {"APPS, eta 0.1", "APPS, eta 0.05", "Newton-Raphson", "Levenberg-Marquardt"}
    assert all(row.count == 40 and 0 <= row.inside_limits <= row.reached <= 1 for row in rows.values())
    assert rows["Levenberg-Marquardt"].inside_limits == 1
    assert rows["APPS, eta 0.1"].reached < rows["Newton-Raphson"].reached


def test_random_pairs_depend_on_the_seed_and_not_on_their_number():
    T, q = compare.random_pairs(20, seed=3)
    T_more, q_more = compare.random_pairs(50, seed=3)
    torch.testing.assert_close((T, q), (T_more[:20], q_more[:20]), rtol=0, atol=1e-15)
    assert not torch.equal(q, compare.random_pairs(20, seed=4)[1])


def test_a_run_that_does_not_converge_is_reported_and_not_hidden():
    motions = solve_motions(replace(ik.Apps.reproduces(), max_steps=3), tol_pos=1e-4, tol_rot=1e-4)
    assert [row.iterations for row in all_tables(motions).table6] == [None] * 7
    assert not any(motion.converged for motion in motions)


def test_rounding_gives_the_start_back():
    q = start_configuration()
    torch.testing.assert_close(round_joints(q + 1e-6), q, atol=1e-15, rtol=0)


def test_misprints_are_numbered_and_carry_their_evidence(study: AppsStudy):
    assert [erratum.number for erratum in study.errata] == list(range(1, 14))
    evidence = {erratum.number: erratum.evidence for erratum in study.errata}
    assert "4.4e-10 to 4.8e-10" in evidence[2]
    assert "0.14 mm off Table 4 and E 1.6e-08" in evidence[4]
    assert "y = 0.019 mm" in evidence[10]
    assert study.errata[9].right == "y = 0.00002; MAE_1 = 0.01, MAE_2 = 0.04"
    assert study.errata[5].right == "-89.6430"
    assert study.errata[8].right == "22.7069 s"


def test_every_claim_holds(study: AppsStudy):
    assert {check.claim for check in study.checks if not check.holds} == set()
    assert len(study.checks) == 8


def test_json_round_trip(study: AppsStudy):
    document = study.to_json()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["iterations"] == ITERATIONS
    assert document["config"]["random_starts"] == 40


def test_tables_for_people_are_rectangular_and_name_units(study: AppsStudy):
    tables = report(study)
    for table in tables:
        assert {len(row) for row in table.rows} == {len(table.columns)}, table.title
    text = " ".join(f"{table.title} {table.columns}" for table in tables)
    assert all(unit in text for unit in ("[deg]", "[mm]", "[m]", "[s]", "[ms]"))


def test_progress_counts_up_to_the_total():
    calls: list[tuple[str, int, int]] = []
    run_study(replace(QUICK, random_starts=0, learning_rates=(0.1,)), progress=lambda *call: calls.append(call))
    assert [done for _, done, _ in calls] == list(range(len(calls)))
    assert {total for _, _, total in calls} == {len(calls)}
    assert calls[0][0] == "motion I-1"


def test_the_study_leaves_torch_as_it_was(study: AppsStudy):
    assert torch.get_default_dtype() == torch.float32
    before = torch.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        run_study(QUICK, progress=lambda *_: 1 // 0)
    assert torch.get_num_threads() == before
