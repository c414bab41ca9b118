"""The Denso VP6242 study and its command: printed numbers, closed form, schemes in small, errata, claims, mistakes."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from support import without_times

import ikgrad as ik
from ikgrad.cli.main import main
from ikgrad.cli.reproduce.denso import FILES
from ikgrad.config import DensoConfig
from ikgrad.data import Cube, SmoothPath
from ikgrad.papers.denso import schemes
from ikgrad.papers.denso.arm import (
    HOME,
    HOME_DEG,
    check_matrices,
    denso,
    dh_matrices,
    home_companions,
    printed_matrix,
    tool_down_ik,
)
from ikgrad.papers.denso.checks import round_trip_m
from ikgrad.papers.denso.figures import FIGURES
from ikgrad.papers.denso.networks import make_data, median, regression, train
from ikgrad.papers.denso.report import report
from ikgrad.papers.denso.study import DensoStudy, run_study
from ikgrad.papers.store import load_study

SHORT_LOOP = {"cure_epochs": 2, "final_epochs": 2, "ticks": 50}
QUICK = DensoConfig(seeds=2, traditional_epochs=6, feedback_epochs=6, epochs=2, **SHORT_LOOP)


class Run(NamedTuple):
    study: DensoStudy
    calls: list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def run() -> Run:
    calls: list[tuple[str, int, int]] = []
    return Run(run_study(QUICK, progress=lambda *call: calls.append(call)), calls)


@pytest.fixture
def study(run: Run) -> DensoStudy:
    return run.study


def test_home_gives_the_printed_pose():
    T = ik.forward_kinematics(denso(), torch.tensor(HOME, dtype=torch.float64))
    assert torch.allclose(T, printed_matrix("T_Home"), rtol=0, atol=1e-12)


@pytest.mark.parametrize("k", range(1, 7))
def test_printed_matrices_are_those_at_zero(k: int):
    assert torch.equal(printed_matrix(f"A_{k}"), dh_matrices(d6=0.17)[k - 1])


def test_the_printed_matrices_multiply_to_the_arm_at_zero():
    product = torch.linalg.multi_dot([printed_matrix(f"A_{k}") for k in range(1, 7)])
    assert torch.allclose(product, ik.forward_kinematics(denso(), torch.zeros(6).double()), atol=1e-15)
    assert torch.allclose(product[:3, 3], torch.tensor([0.135, 0.0, 0.505]).double(), atol=1e-15)


def test_home_has_seven_companions_with_its_pose():
    q = home_companions().deg2rad()
    assert q.shape == (8, 6)
    T = ik.forward_kinematics(denso(), q)
    assert torch.allclose(T, printed_matrix("T_Home").expand(8, 4, 4), atol=1e-10)
    apart = torch.remainder(q[:, None] - q + math.pi, 2 * math.pi) - math.pi
    assert (apart.abs().amax(-1) + 9 * torch.eye(8)).min() > 0.1
    printed = torch.tensor([0.0, 17.23, -39.31, 0.0, -157.92, 0.0]).double().deg2rad()
    off = torch.remainder(q - printed + math.pi, 2 * math.pi) - math.pi
    assert off.abs().amax(-1).min() < math.radians(0.006)


def test_the_closed_form_meets_positions_and_points_down():
    assert round_trip_m() < 1e-9
    p = torch.tensor([[0.2, 0.1, 0.25], [-0.15, 0.1, 0.2], [0.05, -0.2, 0.3]]).double()
    T = ik.forward_kinematics(denso(), tool_down_ik(p))
    assert torch.allclose(T[:, :3, 3], p, atol=1e-12)
    assert torch.allclose(T[:, :3, :3], torch.diag(torch.tensor([-1.0, 1.0, -1.0])).double(), atol=1e-12)


def test_the_closed_form_says_nan_where_the_arm_does_not_reach():
    assert tool_down_ik(torch.tensor([1.0, 0.0, 0.2])).isnan().any()
    with pytest.raises(ik.ShapeError, match=r"p must have shape \(\.\.\., 3\)"):
        tool_down_ik(torch.zeros(4))


def test_the_cube_is_on_the_branch_of_the_closed_form():
    rows = make_data([Cube(home=HOME, count=500, redraw=True)])[0].samples
    assert torch.allclose(tool_down_ik(rows.T[:, :3, 3]), rows.q, atol=1e-10)


def test_regression_is_one_for_the_truth_and_sees_each_joint_about_its_mean():
    target = torch.randn(500, 6, generator=torch.Generator().manual_seed(0)).double()
    assert regression(target, target).item() == pytest.approx(1.0)
    assert regression(target + 100 * torch.arange(6), target).item() == pytest.approx(1.0)
    noise = torch.randn(500, 6, generator=torch.Generator().manual_seed(1)).double()
    assert abs(regression(noise + 100 * torch.arange(6), target + 100 * torch.arange(6)).item()) < 0.1


def test_the_median_of_an_even_number_is_between_the_two_in_the_middle():
    assert median(torch.tensor([4.0, 1.0, 2.0, 9.0])).item() == 3.0


def test_scheme_b_in_small_shows_the_gain_and_the_drift():
    """One seed at 40 epochs: the feedback network is far ahead one-step, and lost in closed loop."""
    result = schemes.scheme_b(1, (40, 40))
    assert result.traditional.mse.item() < 5e-5
    assert result.feedback.mse.item() < 0.05 * result.traditional.mse.item()
    assert result.feedback.regression.item() > 0.9999
    assert result.drift_mm.item() > 10.0
    assert 0 <= result.lost_at.item() < 1000
    assert result.drift[: int(result.lost_at)].max() <= 10.0


def test_percentages_have_two_definitions():
    path = torch.tensor([[0.1, -0.05, 0.2], [0.3, 0.05, 0.3]])
    shares = schemes.percentages(torch.tensor([1.0, 1.0, 1.0]), path)
    assert shares["amplitude"].tolist() == pytest.approx([1.0, 2.0, 2.0])
    assert shares["coordinate"].tolist() == pytest.approx([1 / 3, 2.0, 1 / 3])


def test_the_command_repeats_the_study_and_writes_its_files(
    study: DensoStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    settings, out = tmp_path / "quick.yaml", tmp_path / "out"
    settings.write_text("seeds: 5\ntraditional_epochs: 6\nfeedback_epochs: 6\nepochs: 9\n")
    with settings.open("a") as file:
        file.writelines(f"{key}: {value}\n" for key, value in SHORT_LOOP.items())
    command = ["reproduce", "denso", "--config", str(settings), "--seeds", "2", "--epochs", "2", "--out", str(out)]
    assert main([*command, "--json"]) == 0
    ours = json.loads(capsys.readouterr().out)
    assert without_times(ours) == without_times(json.loads(json.dumps(study.to_json())))
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert load_study(out / "denso_study.npz").to_json() == json.loads((out / "denso.json").read_text())
    assert main(command) == 2
    assert "exists already; it is overwritten with --force only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seeds", "0"], "at least 1"),
        (["--epochs", "-3"], "at least 1"),
        (["--config", "{tmp}/missing.yaml"], "cannot read the configuration"),
        (["--config", "{tmp}/bad.yaml"], "unknown key 'epoch'; did you mean 'epochs'?"),
        (["--config", "{tmp}/zero.yaml"], "seeds must be positive, got 0"),
        (["--out", "{tmp}/no/where"], "does not exist; create it first"),
    ],
)
def test_mistakes_are_explained(options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "bad.yaml").write_text("epoch: 3\n")
    (tmp_path / "zero.yaml").write_text("seeds: 0\n")
    assert main(["reproduce", "denso", *(option.format(tmp=tmp_path) for option in options)]) == 2
    assert message in capsys.readouterr().err


def test_progress_counts_every_network_and_epoch(run: Run):
    assert run.calls[-1][1] == run.calls[-1][2]
    assert [call[1] for call in run.calls] == sorted({call[1] for call in run.calls})


def test_tables_carry_the_papers_numbers_beside_ours(study: DensoStudy):
    tables = {table.title.split(":")[0]: table for table in report(study)}
    assert len(tables) == 14
    for table in tables.values():
        assert all(len(row) == len(table.columns) for row in table.rows), table.title
    text = str([table.rows for table in tables.values()])
    for printed in ("1.1892e-5", "3.3029e-8", "0.99758", "0.17", "5.78", "6.5", "PUMA 560"):
        assert printed in text


def test_table_2_has_millimetres_first_and_says_what_its_percentages_are(study: DensoStudy):
    table = next(table for table in report(study) if table.title.startswith("Table 2"))
    first = table.rows[0]
    assert first[:2] == ("x, largest error [mm], scheme D", "0.22")
    assert float(first[2]) == pytest.approx(median(study.track.closed_mm["feedback"])[0].item(), abs=0.006)
    half = 500 * (study.track.path[:, 0].max() - study.track.path[:, 0].min()).item()  # in mm
    row = next(row for row in table.rows if row[0] == "x, in % of half its range")
    assert float(row[4]) == pytest.approx(100 * float(first[4]) / half, abs=0.03)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_name_the_papers_number_and_our_run(study: DensoStudy, name: str):
    figure = FIGURES[name](study)
    title = figure.get_suptitle()
    number = re.search("figure(\\d+)", name)
    assert title.startswith("Scheme B" if number is None else f"Figure {int(number[1])} of the paper")
    assert "scheme " in title.lower()
    assert "2 " in title  # seeds


def test_figures_4_and_6_end_with_the_errors_of_the_last_epoch(study: DensoStudy):
    result = study.path.feedback
    line = FIGURES["denso_figure06"](study).axes[0].lines[0]
    assert line.get_xdata()[-1] == result.epochs
    assert line.get_ydata()[-1] == pytest.approx(result.curve_train[-1].quantile(0.5).item())
    rows = make_data([SmoothPath(home=HOME, seed=result.median_seed)])[0].test
    assert torch.equal(result.targets, rows.q)
    mse = (result.answers - result.targets).square().mean()
    assert mse.item() == pytest.approx(result.mse[result.median_seed].item(), rel=1e-12)


def test_claims_on_errors_wait_for_the_papers_epochs(study: DensoStudy):
    claims = [check.claim for check in study.checks]
    assert sum("FK" in claim for claim in claims) == 2
    assert not any(claim.startswith(("B:", "D:")) for claim in claims)
    assert all(check.holds for check in study.checks if not check.claim.startswith("A:"))


def test_errata_are_numbered_with_evidence(study: DensoStudy):
    assert [erratum.number for erratum in study.errata] == list(range(1, 13))
    assert all(erratum.evidence for erratum in study.errata)
    assert "8 different joint vectors" in study.errata[9].evidence
    assert "y 83 and 83 mm" in study.errata[7].evidence


@pytest.mark.slow
def test_scheme_b_over_ten_seeds_gives_the_printed_pair():
    data = make_data([SmoothPath(home=HOME, seed=seed) for seed in range(10)])
    traditional, _ = train("traditional", data, 121, seeds=range(10), best=False)
    feedback, _ = train("feedback", data, 68, seeds=range(10), best=False)
    assert ((traditional.mse >= 5e-6) & (traditional.mse <= 3e-5)).all()
    assert median(feedback.mse) < 1e-7
    assert median(traditional.mse) / median(feedback.mse) >= 50
    assert feedback.regression.min() >= 0.9999


def test_the_matrix_table_tells_right_from_wrong():
    rows = check_matrices()
    assert sum(row.difference < 1e-12 for row in rows) == 7
    assert [row.difference for row in rows if row.name == "A_6"] == [0.0, pytest.approx(0.1)]


def test_the_closed_form_takes_any_batch_and_has_gradients():
    home = tool_down_ik(torch.tensor([0.21, 0.0, 0.24], dtype=torch.float64))
    assert home.rad2deg().tolist() == pytest.approx(HOME_DEG, abs=1e-6)  # acos near its end of range
    p = torch.tensor([[[0.2, 0.05, 0.25]], [[0.22, -0.03, 0.2]]], dtype=torch.float64).requires_grad_()
    assert tool_down_ik(p).shape == (2, 1, 6)
    assert torch.autograd.gradcheck(tool_down_ik, p)
