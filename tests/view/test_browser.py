"""The page in a real browser: eyes and a mouse on one side, the session's state on the other.

One page serves all tests, in the order of the file; each begins with "Reset". Skipped where playwright or a Chromium
is missing; `bash scripts/browser.sh` gets both.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.collision import Spheres
from ikgrad.view import Motion, Session, Viewer, start_server
from ikgrad.view.race import inverter_for

headless = pytest.importorskip("headless")
if any(importlib.util.find_spec(name) is None for name in ("viser", "playwright")):
    pytest.skip("needs viser and playwright: pip install 'ikgrad[viz,browser]'", allow_module_level=True)
if headless.find_chromium() is None:
    pytest.skip("needs a Chromium on PATH or in IKGRAD_CHROMIUM; see scripts/browser.sh", allow_module_level=True)
pytestmark = [pytest.mark.timeout(280), pytest.mark.browser]

SIZE = (1000, 640)
ROWS = 60


class Opened(NamedTuple):
    """Both sides of one page."""

    page: Any
    viewer: Viewer

    @property
    def camera(self) -> Any:
        return next(iter(self.viewer.server.get_clients().values())).camera

    @property
    def session(self) -> Session:
        return self.viewer.session

    def settle(self) -> None:
        """Nothing left to do, and the other solutions drawn."""
        self.page.wait_for(lambda: self.viewer.worker.wait(0.0), "rest")

    def anew(self) -> None:
        self.page.press("Reset")
        self.page.wait_for(lambda: torch.equal(self.session.q, self.session.home), "the first pose")
        self.settle()


@pytest.fixture(scope="module")
def browser() -> Iterator[Callable[[], Any]]:
    with headless.chromium(size=SIZE) as new_page:
        yield new_page


@pytest.fixture(scope="module")
def both(browser: Callable[[], Any]) -> Iterator[Opened]:
    robot = ik.load_robot("ur5e")
    session = Session(robot)
    q = session.home + torch.linspace(0, 0.6, ROWS).double()[:, None] * torch.tensor([1.0, 0.3, -0.4, 0.2, 0.5, 0.0])
    sphere = Spheres(torch.tensor([[-0.5, 0.5, 0.2]]).double(), torch.tensor([0.08]).double())
    viewer = Viewer(
        start_server(port=0, label="ikgrad: ur5e"), session,
        motion=Motion("joints.csv", q), spheres=sphere, inverter=inverter_for(robot),
    )  # fmt: skip
    page = browser()
    page.open(f"http://127.0.0.1:{viewer.server.get_port()}")
    page.wait_for(lambda: "solutions found" in page.text(), "the arm and its other solutions")
    page.hide_warning()
    yield Opened(page, viewer)
    viewer.close()


def shown_number(page: Any, pattern: str) -> float:
    return float(re.search(pattern, page.text())[1])


def orange(picture: np.ndarray) -> int:
    """Pixels of the arm's colour."""
    return int((picture[..., 0].astype(int) - picture[..., 2] > 80).sum())


def gizmo(both: Opened) -> tuple[tuple[float, float], tuple[float, float], torch.Tensor]:
    """Where to take hold of the target, where a tenth of a metre along that arrow is, and the arrow's direction."""
    T, size = both.session.T_target, 0.22 * both.session.robot.length
    ways = []
    for axis in T[:3, :3].mT:
        begin = both.page.see(both.camera, (T[:3, 3] + 0.6 * size * axis).numpy())
        end = both.page.see(both.camera, (T[:3, 3] + (0.6 * size + 0.1) * axis).numpy())
        ways.append((np.hypot(end[0] - begin[0], end[1] - begin[1]), begin, end, axis.clone()))
    _, begin, end, axis = max(ways, key=lambda way: way[0])  # the arrow that is seen from the side
    return begin, end, axis


def test_the_page_opens_with_the_arm_its_solutions_and_its_controls(both: Opened):
    page, viewer = both
    text = page.text()
    for words in (
        "ikgrad: ur5e",
        "Target: reached",
        "solutions found",
        "Clearance: free",
        "follow with",
        "Save as HTML",
    ):
        assert words in text
    assert len(viewer.server.get_clients()) == 1
    visible = sum(ghost._root.visible for ghost in viewer.stage.ghosts)
    assert visible == int(shown_number(page, r"(\d+) solutions found")) - 1
    page.wait_for(lambda: orange(page.picture()) > 500, "an arm")
    picture = page.picture()[:, : SIZE[0] // 2].astype(int)  # left of the controls
    red, _, blue = picture.reshape(-1, 3).T
    assert ((blue - red > 15) & (blue > 150)).sum() > 500, "light blue ghosts"
    assert picture.std() > 20, "not blank"


def test_a_slider_that_is_pulled_turns_the_joint(both: Opened):
    both.anew()
    page, home = both.page, both.session.home
    page.tab.get_by_role("tab", name="Joints").click()
    thumb = page.tab.get_by_role("slider").first
    box = thumb.bounding_box()
    begin = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    before = page.picture()
    page.drag(begin, (begin[0] + 25, begin[1]))
    both.settle()
    turned = float((both.session.q - home)[0].rad2deg())
    assert turned > 20  # 25 pixels of 200 for 720 degrees
    assert torch.equal(both.session.q[1:], home[1:])
    assert float(page.tab.get_by_role("textbox").first.input_value()) == pytest.approx(
        float(both.session.q[0].rad2deg()), abs=0.06
    )
    page.wait_for(lambda: (np.abs(page.picture().astype(int) - before) > 30).any(-1).sum() > 2000, "another picture")


def test_the_target_is_dragged_with_the_mouse_and_the_arm_follows(both: Opened):
    both.anew()
    begin, end, axis = gizmo(both)
    before, q = both.session.T_target.clone(), both.session.q.clone()
    both.page.drag(begin, end)
    both.settle()
    moved = (both.session.T_target - before)[:3, 3]
    assert 0.03 < float(moved @ axis) < 0.2
    assert float((moved - (moved @ axis) * axis).norm()) < 1e-3  # along the arrow, nowhere else
    assert float((both.session.q - q).abs().max()) > 0.02
    assert torch.allclose(ik.forward_kinematics(both.session.robot, both.session.q), both.session.T_target, atol=1e-5)
    both.page.wait_for(lambda: "Target: reached" in both.page.text(), "the words")


@pytest.mark.parametrize("name", ["Newton-Raphson", "neural inverter", "APPS", "Levenberg-Marquardt"])
def test_another_method_follows_the_target(both: Opened, name: str):
    both.anew()
    both.page.choose("follow with", name)
    both.page.wait_for(lambda: both.session.method is both.viewer.methods[name], name)
    begin, end, _ = gizmo(both)
    before = both.session.T_target.clone()
    both.page.drag(begin, end)
    both.settle()  # APPS comes to an end by itself
    assert float((both.session.T_target - before)[:3, 3].norm()) > 0.03
    left = float((ik.forward_kinematics(both.session.robot, both.session.q) - both.session.T_target)[:3, 3].norm())
    wanted = (
        "Target: reached"
        if left < 1e-6
        else {"APPS": "Target not met: APPS has not arrived"}.get(name, "Target nearly met: the network's own answer")
    )
    both.page.wait_for(lambda: wanted in both.page.text(), wanted)
    assert left < {"neural inverter": 0.02, "APPS": 0.02}.get(name, 1e-6)


def test_a_motion_is_played_to_its_end(both: Opened):
    both.anew()
    page, motion = both.page, both.viewer.motion
    page.tab.get_by_role("tab", name="Motion").click()
    assert "joints.csv" in page.text()
    page.press("Play")
    page.wait_for(lambda: torch.equal(both.session.q, motion.q[-1]), "the last row")
    page.wait_for(lambda: page.tab.get_by_role("button", name="Play").is_visible(), "the end")
    assert page.tab.get_by_role("textbox").first.input_value() == str(ROWS - 1)


def test_what_is_played_is_saved_and_opens_without_a_network(both: Opened, browser: Any, tmp_path: Path):
    page = both.page
    with page.tab.expect_download(timeout=120_000) as waiting:
        page.press("Save as HTML")
    assert waiting.value.suggested_filename == "ur5e-motion.html"
    waiting.value.save_as(tmp_path / "saved.html")
    page.wait_for(lambda: "Save as HTML" in page.text(), "the button again")
    page.tab.set_viewport_size({"width": 200, "height": 120})  # it draws all the time, on the same processor
    saved = browser()
    saved.tab.context.set_offline(True)
    saved.open((tmp_path / "saved.html").as_uri())
    saved.wait_for(lambda: saved.picture().std() > 12, "a picture")
    saved.wait_for(lambda: orange(saved.picture()) > 500, "an arm")
    first = saved.picture().astype(int)
    saved.wait_for(lambda: (np.abs(saved.picture() - first) > 30).any(-1).sum() > 500, "motion")
    assert all(url.startswith(("file:", "blob:", "data:")) for url in saved.asked)
    assert (saved.refused, saved.errors) == ([], [])
    saved.tab.close()
    page.tab.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})


def test_the_methods_run_side_by_side(both: Opened):
    both.anew()
    page = both.page
    page.tab.get_by_role("tab", name="Methods").click()
    page.press("Run on this target")
    page.wait_for(lambda: "drag it away first" in page.text(), "nothing to run for")
    begin, end, _ = gizmo(both)
    page.drag(begin, end)
    both.settle()
    page.press("Run on this target")
    page.wait_for(lambda: page.text().count(" steps") >= 4, "four results")
    for run in both.viewer._contest.runs:
        assert f"{run.name}: {run.words}" in page.text()
    page.wait_for(lambda: both.viewer.worker.wait(0.0), "the end of the film")
    runs = both.viewer._contest.runs
    for arm, run in zip(both.viewer._contest.arms, runs, strict=True):
        tip = ik.link_poses(both.session.robot, run.q[-1])[max(arm._frames), :3, 3]
        assert torch.allclose(torch.from_numpy(arm._frames[max(arm._frames)].position), tip)
    hues = page.picture()[:, : SIZE[0] // 2].astype(int).reshape(-1, 3).T
    red, green, blue = hues
    assert ((blue - red > 60) & (blue - green > 30)).sum() > 200, "a blue arm"
    assert ((green - red > 50) & (green > blue)).sum() > 200, "a green arm"
    assert page.tab.locator(".u-over").count() >= 1, "curves"
    page.press("Back to the arm")
    page.wait_for(lambda: both.viewer._contest is None, "the one arm")
    assert page.text().count(" steps") >= 4  # to be read on


def test_nothing_leaves_the_machine(both: Opened):
    """After all that: every request of the page stayed here, and this process has no connection to elsewhere."""
    assert both.page.asked
    assert all(headless.is_local(url) for url in both.page.asked)
    assert any(url.startswith("ws://127.0.0.1") for url in both.page.asked)
    assert both.page.refused == []
    assert both.page.errors == []
    if sys.platform != "linux":
        return
    peers = connected_peers(os.getpid())
    assert peers, "the page's own connection at least"
    assert peers <= {"127.0.0.1", "::1"}
    both.page.tab.close()


def connected_peers(pid: int) -> set[str]:
    """Addresses at the other ends of a process's TCP connections."""
    sockets = {os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()}
    peers = set()
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[3] == "01" and f"socket:[{fields[9]}]" in sockets:
            address = bytes.fromhex(fields[2].split(":")[0])[::-1]
            peers.add(".".join(map(str, address)))
    return peers


def test_the_command_opens_a_page_of_its_own(browser: Any):
    """`ikgrad view --path puma` as it is typed: the robot comes with the path."""
    command = [sys.executable, "-m", "ikgrad", "view", "--path", "puma", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = re.search(r"http://\S+", process.stdout.readline())[0]
            page = browser()
            page.open(url)
            page.wait_for(lambda: "puma, its nine poses" in page.text(), "the motion")
            assert "ikgrad: puma560" in page.text()
            assert (page.refused, page.errors) == ([], [])
            page.tab.close()
        finally:
            process.terminate()
