"""A page of `ikgrad view` in a Chromium without a window: for the browser tests, the screenshots and first_look.py.

Needs playwright (the extra 'browser') and some Chromium: the one that IKGRAD_CHROMIUM names, or one on PATH.
Nothing but 127.0.0.1 can be reached from the page; whatever it asks for is written down.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# WebGL on the CPU, so that a machine without a display or a GPU will do; a browser has no sandbox for root.
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--ignore-gpu-blocklist", "--disable-background-networking")  # fmt: skip
SIZE = (1200, 800)
LOCAL = ("127.0.0.1", "localhost")


def find_chromium() -> str | None:
    """Path of a Chromium, None if there is none."""
    named = os.environ.get("IKGRAD_CHROMIUM")
    if named:
        return named if Path(named).is_file() else None
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """An open page, and how to use it like a person: by eye and by mouse.

    Attributes:
        tab: playwright's page.
        asked: every URL that was requested, websockets included.
        refused: those that did not stay on this machine.
        errors: of the page's own code.
    """

    def __init__(self, context: Any):
        self.asked: list[str] = []
        self.refused: list[str] = []
        self.errors: list[str] = []
        self.tab = context.new_page()
        self.tab.set_default_timeout(120_000)  # where a busy machine draws on its CPU, a picture can take many seconds
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.on("websocket", lambda channel: self.asked.append(channel.url))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        context.route("**/*", self._guard)

    def _guard(self, route: Any) -> None:
        if is_local(route.request.url):
            route.continue_()
        else:
            self.refused.append(route.request.url)
            route.abort()

    def open(self, url: str) -> None:
        """Go there and wait for the scene's canvas."""
        self.tab.goto(url)
        drawn = "() => [...document.querySelectorAll('canvas')].some(canvas => canvas.width > 300)"
        self.tab.wait_for_function(drawn, timeout=90_000)

    def text(self) -> str:
        """What can be read on the page."""
        return str(self.tab.inner_text("body"))

    def wait_for(self, true: Callable[[], bool], what: str, *, seconds: float = 120) -> None:
        """Until something is so; AssertionError after the time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if true():
                return
            self.tab.wait_for_timeout(100)
        raise AssertionError(f"the page did not come to that: {what}; it reads: {self.text()[:400]}")

    def choose(self, label: str, option: str) -> None:
        """An entry of a list."""
        self.tab.get_by_label(label).first.click()
        self.tab.get_by_role("option", name=option, exact=True).click()

    def press(self, name: str) -> None:
        """A button."""
        self.tab.get_by_role("button", name=name).click()

    def picture(self, path: Path | None = None) -> np.ndarray:
        """(h, w, 3) bytes of what is seen."""
        import io

        from PIL import Image

        data = self.tab.screenshot(path=path)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def hide_warning(self) -> None:
        """Away with viser's note that WebGL runs on the CPU; it stands over the scene."""
        self.tab.add_style_tag(content=".mantine-Notification-root { display: none }")

    def see(self, camera: Any, point: np.ndarray) -> tuple[float, float]:
        """Pixel at which a point of the scene is seen.

        Args:
            camera: viser's handle of this client.
            point: (3,) [m].
        """
        width, height = self.tab.viewport_size["width"], self.tab.viewport_size["height"]
        stand = np.asarray(camera.position)
        ahead = np.asarray(camera.look_at) - stand
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, camera.up_direction)
        right /= np.linalg.norm(right)
        x, y, depth = np.array([right, np.cross(right, ahead), ahead]) @ (np.asarray(point) - stand)
        scale = height / 2 / np.tan(camera.fov / 2) / depth
        return float(width / 2 + scale * x), float(height / 2 - scale * y)

    def drag(
        self, begin: tuple[float, float], end: tuple[float, float], *, moves: int = 12, hold: bool = False
    ) -> None:
        """Press the mouse, move, release (or not)."""
        mouse, (x, y) = self.tab.mouse, begin
        mouse.move(x, y)
        self.tab.wait_for_timeout(300)  # what is under the mouse is found when the next picture is drawn
        mouse.move(x + 0.5, y + 0.5)
        self.tab.wait_for_timeout(300)
        mouse.down()
        for k in range(1, moves + 1):
            mouse.move(x + (end[0] - x) * k / moves, y + (end[1] - y) * k / moves)
        mouse.up()


def is_local(url: str) -> bool:
    """Whether a URL stays on this machine: its own server, or data that the page made itself."""
    parts = urlsplit(url.removeprefix("blob:"))
    return parts.scheme in ("data", "file", "about", "chrome") or parts.hostname in LOCAL


@contextlib.contextmanager
def chromium(*, size: tuple[int, int] = SIZE, offline: bool = False) -> Iterator[Callable[[], Page]]:
    """A browser, as a function that opens an empty page."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=find_chromium(), args=list(FLAGS))
        viewport = {"width": size[0], "height": size[1]}
        try:
            yield lambda: Page(browser.new_context(viewport=viewport, offline=offline, accept_downloads=True))
        finally:
            browser.close()
