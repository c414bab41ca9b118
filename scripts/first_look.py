"""Seconds from `git clone` to an arm that moves in the browser, as a newcomer would do it.

    python scripts/first_look.py [URL or path of the repository]

In a temporary folder: git clone, `bash scripts/setup.sh`, `.venv/bin/ikgrad view --robot panda`, a Chromium opens the
page, a mouse drags the target, and the clock stops when the joints that the page shows have changed. Run it with a
Python that has ikgrad and playwright; the clone gets an environment of its own. Downloads count; pip's cache helps.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from headless import Page, chromium

import ikgrad as ik
from ikgrad.view import Session
from ikgrad.view.scene import FIELD_OF_VIEW, camera

ROBOT = "panda"


def main() -> None:
    """Clone, install, start, look, drag; print the times."""
    source = sys.argv[1] if len(sys.argv) > 1 else str(Path(__file__).parents[1])
    session = Session(ik.load_robot(ROBOT))
    with tempfile.TemporaryDirectory() as folder, chromium() as new_page:
        clone, began = Path(folder) / "ikgrad", time.perf_counter()

        def lap(what: str) -> None:
            print(f"{time.perf_counter() - began:7.1f} s  {what}", flush=True)

        subprocess.run(["git", "clone", "--quiet", source, str(clone)], check=True)
        lap("git clone")
        subprocess.run(["bash", "scripts/setup.sh"], check=True, cwd=clone)
        lap("bash scripts/setup.sh")
        command = [clone / ".venv/bin/ikgrad", "view", "--robot", ROBOT, "--port", "0", "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as server:
            assert server.stdout is not None
            try:
                url = re.search(r"http://\S+", server.stdout.readline())
                assert url is not None
                lap(f"ikgrad view --robot {ROBOT} has a page")
                page = new_page()
                page.open(url[0])
                page.wait_for(lambda: "Target: reached" in page.text(), "the arm")
                lap("the browser shows it")
                joint = page.tab.get_by_role("textbox").first
                before = joint.input_value()
                page.drag(*arrow(page, session))
                page.wait_for(lambda: joint.input_value() != before, "joints that change")
                lap("the target is dragged and the arm has moved")
            finally:
                server.terminate()


def arrow(page: Page, session: Session) -> tuple[tuple[float, float], tuple[float, float]]:
    """Pixels where to take hold of the target, and a tenth of a metre on.

    Along the arrow that is seen from the side, from where the page's camera stands at first.
    """
    robot, T = session.robot, session.T_target.numpy()
    stand, look_at = camera(robot.length)
    eye = SimpleNamespace(position=stand, look_at=look_at, up_direction=(0, 0, 1), fov=FIELD_OF_VIEW)
    grip, far = 0.13 * robot.length, 0.13 * robot.length + 0.1
    ways = [[page.see(eye, T[:3, 3] + r * axis) for r in (grip, far)] for axis in T[:3, :3].T]
    return max(ways, key=lambda way: np.hypot(*np.subtract(*way)))


if __name__ == "__main__":
    main()
