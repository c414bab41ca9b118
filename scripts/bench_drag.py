"""How often the arm follows a target that is dragged in a Chromium on this machine: updates a second, and gaps.

    python scripts/bench_drag.py [--robot panda] [--seconds 6]

Twice for each page: with targets that arrive 100 times a second, as from a fast browser, while the Chromium only
watches; and with a mouse that pulls the target by an arrow, where the browser sends a target for each picture that it
has drawn. Without a GPU it draws on the same processor. Needs the extra 'browser' and a Chromium (scripts/browser.sh).
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import torch
from first_look import drag_target
from headless import Page, chromium

import ikgrad as ik
from ikgrad.view import Session, Viewer, start_server

RATE = 100.0  # targets a second
SIZES = ((1200, 800), (800, 500))


class Watched:
    """A page whose answers are timed."""

    def __init__(self, robot: ik.Robot, page: Page):
        self.session = Session(robot)
        self.viewer = Viewer(start_server(port=0), self.session)
        self.page, self.times, self._reach = page, [0.0], self.session.reach
        self.session.reach = self._timed  # type: ignore[method-assign]
        page.open(f"http://127.0.0.1:{self.viewer.server.get_port()}")
        page.hide_warning()
        page.wait_for(lambda: "solutions" in page.text(), "the arm")

    def _timed(self, *args: Any, **options: Any) -> Any:
        answer = self._reach(*args, **options)
        self.times.append(time.perf_counter())
        return answer

    def stream(self, seconds: float) -> str:
        """Targets on a circle of a tenth of the arm's length."""
        T, size, begin = self.session.T_target.clone(), 0.1 * self.session.robot.length, time.perf_counter()
        self.times = []
        for k in range(int(seconds * RATE)):
            angle = torch.tensor(6.28 * k / (seconds * RATE))
            there = T.clone()
            there[:2, 3] += size * torch.stack([angle.sin(), 1 - angle.cos()])
            self.viewer.drag(there)
            self.page.tab.wait_for_timeout(max(0.0, 1e3 * (begin + (k + 1) / RATE - time.perf_counter())))
        return self._told()

    def mouse(self, seconds: float) -> str:
        """The arrow, there and back, for as long."""
        self.viewer.reset()
        self.viewer.worker.wait(5)
        self.times, end = [], time.perf_counter() + seconds
        while time.perf_counter() < end:
            drag_target(self.page, self.session, moves=60)
            self.viewer.reset()
            self.viewer.worker.wait(5)
        return self._told()

    def _told(self) -> str:
        gaps = np.diff(self.times)
        gaps = gaps[gaps < 1.0]  # between two pulls of the mouse
        middle, most = 1e3 * np.percentile(gaps, [50, 95])
        return f"{1 / gaps.mean():.0f} a second, gaps of {middle:.0f} ms, 95 % within {most:.0f} ms"


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each measurement")
    args = parser.parse_args()
    torch.set_num_threads(1)
    robot = ik.load_robot(args.robot)
    for size in SIZES:
        with chromium(size=size) as new_page:
            watched = Watched(robot, new_page())
            for shadows in (True, False):
                if not shadows:
                    watched.page.tab.get_by_label("shadows").click()
                where = f"{robot.name}, {size[0]} x {size[1]}, shadows {'on' if shadows else 'off'}"
                print(f"{where}: {RATE:.0f} targets a second: {watched.stream(args.seconds)}", flush=True)
                print(f"{where}: mouse: {watched.mouse(args.seconds)}", flush=True)
            watched.viewer.close()


if __name__ == "__main__":
    main()
