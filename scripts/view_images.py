"""Make docs/images/view_*.png anew: the page of `ikgrad view` in a Chromium without a window.

    python scripts/view_images.py                     # the pictures that need built-in robots only
    python scripts/view_images.py --urdf panda.urdf --meshes descriptions/ --tip panda_hand   # and the one with meshes

Needs playwright and a Chromium, see headless.py. About two minutes on two cores without a GPU.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from headless import Page, chromium
from PIL import Image

import ikgrad as ik
from ikgrad.view import Session, Viewer, start_server
from ikgrad.view.meshes import read_look
from ikgrad.view.paths import find_path, named_motion
from ikgrad.view.race import inverter_for

FOLDER = Path(__file__).parents[1] / "docs" / "images"
SIZE = (1360, 860)
MOST_BYTES = 300_000
PANDA = (0.3, -0.5, 0.2, -2.1, 0.3, 1.8, 0.9)


def main() -> None:
    """Parse, open a browser, take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--urdf", help="a URDF that names meshes")
    parser.add_argument("--meshes", help="where they are")
    parser.add_argument("--tip", help="link whose pose is meant")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder (docs/images)")
    parser.add_argument("--only", help="one of panda, motion, meshes")
    args = parser.parse_args()
    torch.set_num_threads(1)
    with chromium(size=SIZE) as new_page:
        if args.only in (None, "panda"):
            page_and_race(new_page, args.out)
        if args.only in (None, "motion"):
            motion(new_page, args.out)
        if args.urdf and args.only in (None, "meshes"):
            meshes(new_page, args)


def opened(new_page: Callable[[], Page], robot: ik.Robot, q: Any = None, **extras: Any) -> tuple[Page, Viewer]:
    """A page of a robot, drawn to its end."""
    session = Session(robot, q=None if q is None else torch.as_tensor(q, dtype=torch.float64))
    viewer = Viewer(start_server(port=0, label=f"ikgrad: {robot.name}"), session, **extras)
    page = new_page()
    page.open(f"http://127.0.0.1:{viewer.server.get_port()}")
    page.wait_for(lambda: "solution" in page.text(), "solutions")
    page.hide_warning()
    return page, viewer


def shoot(page: Page, path: Path) -> None:
    """A picture of few colours, as pages like theirs have, so that it is small."""
    page.tab.mouse.move(20, SIZE[1] - 20)
    page.tab.wait_for_timeout(3000)
    page.picture(path)
    Image.open(path).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path}: {size / 1000:.0f} kB")
    assert size < MOST_BYTES, f"{path} has {size} bytes"


def close(page: Page, viewer: Viewer) -> None:
    """Away with both: a page in the background goes on drawing."""
    page.tab.close()
    viewer.close()


def page_and_race(new_page: Callable[[], Page], folder: Path) -> None:
    """A Panda's race, and then the arm with other solutions and the curves of the race beside it."""
    robot = ik.load_robot("panda")
    page, viewer = opened(new_page, robot, PANDA, inverter=inverter_for(robot))
    T = viewer.session.T_target.clone()
    T[:3, 3] += torch.tensor([0.05, -0.35, 0.1], dtype=torch.float64)
    viewer.drag(T, thorough=True)
    page.tab.get_by_role("tab", name="Methods").click()
    page.tab.get_by_role("button", name="Run on this target").click()
    page.wait_for(lambda: "steps" in page.text(), "the race")
    page.wait_for(lambda: "Pause" not in page.text(), "its end")
    shoot(page, folder / "view_race.png")
    page.tab.get_by_role("button", name="Back to the arm").click()
    page.wait_for(lambda: "shown" in page.text(), "other solutions")
    shoot(page, folder / "view_panda.png")
    close(page, viewer)


def motion(new_page: Callable[[], Page], folder: Path) -> None:
    """The trajectory study's arm on its way past the obstacle."""
    name = "trajectory"
    path = find_path(name)
    robot = ik.load_robot(path.robot)
    assert path.spheres is not None
    motion = named_motion(name, robot)
    page, viewer = opened(new_page, robot, motion.q[0], motion=motion, spheres=path.spheres())
    page.tab.get_by_label("other solutions").first.uncheck(force=True)
    viewer.worker.submit("row", lambda: viewer._controls.motion.show(188))
    page.wait_for(lambda: "contact" in page.text(), "contact")
    shoot(page, folder / "view_motion.png")
    close(page, viewer)


def meshes(new_page: Callable[[], Page], args: argparse.Namespace) -> None:
    """An arm that has meshes, with its hand at a target."""
    robot = ik.load_robot(args.urdf, tip=args.tip)
    look = read_look(args.urdf, robot, args.meshes)
    page, viewer = opened(new_page, robot, PANDA if robot.dof == 7 else None, look=look)
    shoot(page, args.out / "view_meshes.png")
    close(page, viewer)


if __name__ == "__main__":
    main()
