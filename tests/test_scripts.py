"""The example scripts do what their first lines say."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, timeout=280)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_calibration_takes_the_tool_error_below_a_thousandth():
    printed = run("scripts/calibrate_kr210.py", "--seed", "3", "--iterations", "60")
    ratio = re.search(r"ratio: +(\S+) (\S+),", printed)
    assert ratio is not None
    assert all(float(value) < 1e-3 for value in ratio.groups()), printed


def test_the_survey_loads_every_built_in_robot():
    printed = run("scripts/survey_urdfs.py", "urdf")
    assert "7 files: {'loaded': 7}; 7 chains compared" in printed


def test_the_stages_of_learning_go_on_where_they_stopped(tmp_path: Path):
    record, picture = tmp_path / "stages.json", tmp_path / "stages.png"
    few = ("--robots", "arm4", "--minutes", "0.002", "--seeds", "4", "--rows", "200", "--json", str(record))
    assert run("scripts/bench_learning.py", *few).count("arm4|4|0.002|") == 8
    kept = json.loads(record.read_text())
    del kept["arm4|4|0.002|no network"]
    record.write_text(json.dumps(kept))
    again = run("scripts/bench_learning.py", *few, "--picture", str(picture))
    assert re.findall(r"arm4\|4\|0\.002\|[a-z ]+", again) == ["arm4|4|0.002|no network "]
    assert again.count(" % |\n") == 8
    assert picture.stat().st_size > 10_000


def test_trajectories_are_timed_beside_scipy():
    printed = run("scripts/bench_trajectories.py", "--trajectories", "5", "--times", "10", "--rounds", "2")
    assert printed.count(" ms") == 12
    assert printed.count(" of ours") == 4
