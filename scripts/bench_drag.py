"""How often the arm follows a target that is dragged in a Chromium on this machine: updates a second, and gaps.

    python scripts/bench_drag.py [--robot panda] [--seconds 6]

Twice each: with targets that arrive 100 times a second, as from a fast browser, while the Chromium only
watches; and with a mouse that pulls the target by an arrow, where the browser sends a target for each picture that it
has drawn. Without a GPU it draws on the same processor. Needs the extra 'browser' and a Chromium (scripts/browser.sh).
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import torch
from first_look import arrow
from headless import Page, chromium

import ikgrad as ik
from ikgrad.view import Session, Viewer, start_server

RATE = 100.0  # targets a second


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
        """The arrow, there and back once a second, as fast as a hand moves."""
        self.viewer.reset()
        self.page.tab.wait_for_timeout(1500)
        begin, end = (np.array(pixel) for pixel in arrow(self.page, self.session))
        mouse, pause = self.page.tab.mouse, self.page.tab.wait_for_timeout
        mouse.move(*begin)
        pause(300)  # what is under the mouse is found when the next picture is drawn
        mouse.move(*(begin + 0.5))
        pause(300)
        mouse.down()
        self.times, start = [], time.perf_counter()
        while (now := time.perf_counter() - start) < seconds:
            mouse.move(*(begin + (end - begin) * np.sin(np.pi * now) ** 2))
            pause(8)
        mouse.up()
        pause(500)
        return self._told()

    def _told(self) -> str:
        gaps = np.diff(self.times)
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
    with chromium() as new_page:
        watched = Watched(robot, new_page())
        for shadows in ("on", "off"):
            if shadows == "off":
                watched.page.tab.get_by_label("shadows").click()
            print(f"shadows {shadows}, {RATE:.0f} targets a second: {watched.stream(args.seconds)}", flush=True)
            print(f"shadows {shadows}, a mouse in the browser: {watched.mouse(args.seconds)}", flush=True)
        watched.viewer.close()


if __name__ == "__main__":
    main()
