"""``ikgrad view``: the robot in a web page."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, add_robot_options, example, numbers
from ikgrad.cli.terminal import note
from ikgrad.errors import ConfigError
from ikgrad.extras import check

if TYPE_CHECKING:
    from ikgrad.collision import Spheres
    from ikgrad.networks.storage import AnyInverter
    from ikgrad.robot import Robot
    from ikgrad.view import Motion, Session
    from ikgrad.view.meshes import Look

DESCRIPTION = """\
the robot in a web page: turn its joints, drag a target and see it solved by the method of your choice, with all other
solutions as ghosts; watch APPS, Newton-Raphson, Levenberg-Marquardt and a neural inverter on the same target; play a
file of joints or the path of a study.

Needs the extra 'viz'. The page is served to this machine only, unless --host says otherwise, and asks nothing of the
network. Ctrl-C ends it. With --export no server stays: a page is written that can be opened from a file."""

STUDIES = ("apps", "puma", "denso", "denso-square", "denso-eight", "trajectory", "trajectory-2")  # of ikgrad.view.paths


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "view",
        help="the robot in a web page",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=example(
            "ikgrad view --robot panda\n"
            "ikgrad view --robot panda --path joints.csv --sphere 0.5,0.2,0.6,0.1\n"
            "ikgrad view --path apps\n"
            "ikgrad view --robot arm.urdf --meshes descriptions/\n"
            "ikgrad view --robot panda --path joints.csv --export motion.html"
        ),
    )
    add_robot_options(parser, required=False)
    parser.add_argument("--q", type=numbers, metavar="Q1,Q2,...", help="joints to begin with [rad, or m for slides]")
    text = "joints to play: a .csv, .npy, .npz or .parquet file, or the path of a study, which brings its robot: "
    parser.add_argument("--path", metavar="FILE|NAME", help=text + ", ".join(STUDIES))
    text = "folder with the meshes that the URDF names (package://arm/x.stl is DIR/arm/x.stl or DIR/x.stl)"
    parser.add_argument("--meshes", metavar="DIR", help=text)
    text = "an obstacle, centre and radius [m]; may be given several times"
    parser.add_argument("--sphere", action="append", type=numbers, metavar="X,Y,Z,RADIUS", help=text)
    text = "a trained inverter to run beside the methods (default: the ready-made one of the robot, if any)"
    parser.add_argument("--inverter", metavar="RUN", help=text)
    parser.add_argument("--export", metavar="PAGE", help="write an .html page and stop")
    parser.add_argument("--force", action="store_true", help="overwrite PAGE")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (127.0.0.1: this machine only)")
    parser.add_argument("--port", type=_port, default=8080, help="0: any free one (8080)")
    parser.add_argument("--no-browser", action="store_true", help="open no browser window")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve the page, or write it."""
    check("viser", extra="viz", what="pages of `ikgrad view`")
    import torch

    from ikgrad.robot import load_robot
    from ikgrad.view import Session, export_page

    torch.set_num_threads(1)  # single poses: a second thread only costs
    robot = load_robot(_robot_name(args), base=args.base, tip=args.tip)
    motion, spheres = _motion(args.path, robot)
    spheres = _spheres(args.sphere) if args.sphere else spheres
    look = _look(args, robot)
    q = torch.tensor(args.q, dtype=torch.float64) if args.q else None
    session = Session(robot, q=q if motion is None or q is not None else motion.q[0].clamp(robot.q_min, robot.q_max))
    if args.export:
        page = export_page(args.export, session, motion=motion, spheres=spheres, look=look, force=args.force)
        print(f"{robot.name} -> {page} ({page.stat().st_size / 1e6:.1f} MB)")
        return 0
    return _serve(args, session, motion=motion, spheres=spheres, look=look, inverter=_inverter(args.inverter, robot))


def _serve(args: argparse.Namespace, session: Session, **extras: object) -> int:
    from ikgrad.view import Viewer, start_server

    server = start_server(host=args.host, port=args.port, label=f"ikgrad: {session.robot.name}")
    viewer = Viewer(server, session, **extras)  # type: ignore[arg-type]
    url = f"http://{_shown(args.host)}:{server.get_port()}"
    print(f"{session.robot.name}: {url} (Ctrl-C ends it)", flush=True)
    if not args.no_browser and _has_display():
        import webbrowser

        webbrowser.open(url)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        note("the page is closed")
        return 0
    finally:
        viewer.close()


def _robot_name(args: argparse.Namespace) -> str:
    """As given, or the one that a study's path belongs to."""
    if args.robot:
        return str(args.robot)
    if args.path in STUDIES:
        from ikgrad.view.paths import find_path

        return find_path(args.path).robot
    raise ConfigError(f"--robot is missing; only a path of a study brings its own robot ({', '.join(STUDIES)})")


def _motion(path: str | None, robot: Robot) -> tuple[Motion | None, Spheres | None]:
    """What is played, and the obstacles that belong to it."""
    from ikgrad.view import read_motion
    from ikgrad.view.paths import find_path, named_motion

    if path is None:
        return None, None
    if "." in path or os.sep in path or os.path.exists(path):
        return read_motion(path, robot), None
    motion, spheres = named_motion(path, robot), find_path(path).spheres
    return motion, spheres() if spheres else None


def _look(args: argparse.Namespace, robot: Robot) -> Look | None:
    """The meshes of a URDF file, with a line for what could not be read."""
    from ikgrad.resources import builtin_names
    from ikgrad.view.meshes import read_look

    if args.meshes is None:
        return None
    if args.robot is None or args.robot in builtin_names("urdf"):
        raise ConfigError("built-in robots have no meshes; give --meshes with a URDF file that names some")
    look = read_look(args.robot, robot, args.meshes)
    for line in look.notes:
        note(line)
    return look


def _inverter(name: str | None, robot: Robot) -> AnyInverter | None:
    from ikgrad.networks import load_inverter
    from ikgrad.view.race import inverter_for

    return load_inverter(name, robot=robot) if name else inverter_for(robot)


def _spheres(given: list[tuple[float, ...]]) -> Spheres:
    import torch

    from ikgrad.collision import Spheres

    for values in given:
        if len(values) != 4:
            raise ConfigError(f"--sphere takes four numbers, X,Y,Z,RADIUS, got {','.join(map(str, values))}")
    rows = torch.tensor(given, dtype=torch.float64)
    return Spheres(rows[:, :3], rows[:, 3])


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"expected a port from 0 to 65535, got '{text}'")
    return int(text)


def _shown(host: str) -> str:
    """An address that a browser on this machine can open."""
    if host in ("0.0.0.0", "::", ""):
        return "localhost"
    return f"[{host}]" if ":" in host else host


def _has_display() -> bool:
    """Whether a browser window can open; else a text browser might take the terminal."""
    windowed = sys.platform in ("darwin", "win32")
    return windowed or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
