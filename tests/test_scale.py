"""The model of scripts/scale_model.py, and scripts/bench_scale.py on a few poses."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
sys.path.insert(0, str(SCRIPTS))
import scale_model  # noqa: E402

sys.path.remove(str(SCRIPTS))


def test_the_fit_goes_through_its_runs_and_predicts_others():
    true = scale_model.Cost(start=2.5, pose=4e-6, bytes_in=56, bytes_out=73)
    runs = [(count, true.seconds(count, 1)) for count in (1e6, 1e5)]
    cost = scale_model.fit(runs, bytes_in=56, bytes_out=73)
    assert cost.seconds(1e7, 2) == pytest.approx(2.5 + 1e7 * 4e-6 / 2)
    assert (cost.start, cost.pose) == pytest.approx((2.5, 4e-6))


def test_the_plan_is_arithmetic_that_can_be_done_by_hand():
    cost = scale_model.Cost(start=9.0, pose=3.6e-6, bytes_in=50, bytes_out=75)
    given = scale_model.Assumptions(
        cores=100, core_hour=0.05, gb_month=0.02, months=3, link=8, rows=100_000, note_bytes=500
    )
    found = scale_model.plan(cost, 1e12, given)
    assert found.core_hours == pytest.approx(1000)
    assert found.hours == pytest.approx(10)
    assert found.money_cores == pytest.approx(50)
    assert found.terabytes == pytest.approx(125)
    assert found.money_storage == pytest.approx(125_000 * 0.02 * 3)
    assert found.partitions == pytest.approx(1e7)
    assert found.notes == pytest.approx(5e9)
    # 8 Gbit/s are 1e9 bytes a second; a core moves 125 bytes in 3.6 us.
    assert found.fed_cores == pytest.approx(1e9 / (125 / 3.6e-6))


def test_every_option_of_the_plan_is_used():
    def printed(*options: str) -> str:
        command = [sys.executable, str(SCRIPTS / "scale_model.py"), *options]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout

    usual = printed()
    for option in ("micros", "bytes-in", "bytes-out", "cores", "core-hour", "gb-month", "months", "link", "rows"):
        assert printed(f"--{option}", "7") != usual, option
    assert "3e6 poses" in printed("--plan", "3e6")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs ikgrad[distributed]")
def test_the_benchmark_compares_engines_and_goes_on_where_it_stopped(tmp_path: Path):
    record = tmp_path / "scale.json"
    words = [
        "--counts",
        "300",
        "--rows",
        "200",
        "--rounds",
        "1",
        "--json",
        str(record),
        "--work",
        str(tmp_path / "work"),
    ]
    command = [sys.executable, str(SCRIPTS / "bench_scale.py"), *words]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    runs = [subprocess.run(command, capture_output=True, text=True, check=True, env=environment)]
    kept = json.loads(record.read_text())
    del kept["300 ray, 2 workers 0"]
    record.write_text(json.dumps(kept))
    runs.append(subprocess.run(command, capture_output=True, text=True, check=True, env=environment))
    assert [run.stdout.count("files, all the same") for run in runs] == [1, 1]
    assert "3 x 9 files" in runs[0].stdout  # 300 poses, 37 at a time
    assert re.findall(r"^300.*", runs[1].stderr, re.MULTILINE) == ["300 sample ...", "300 ray, 2 workers 0 ..."]
    assert not list((tmp_path / "work").iterdir())
