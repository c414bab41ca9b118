"""``ikgrad plot``: the right figure for a file or a training run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, add_robot_options, count, example, numbers
from ikgrad.cli.terminal import print_json
from ikgrad.errors import ConfigError

if TYPE_CHECKING:
    from ikgrad.plots.families import Options, Recognised
    from ikgrad.robot import Robot

DESCRIPTION = """\
draw the figure that fits: the content of INPUT decides, not its name. --kind chooses another one:

"""
LINES = """\
a joint file      summary (errors with percentiles, steps, reasons; with --robot also over the workspace),
                  workspace, joints, arm (these three need --robot)
a pose file       places (where they are, where the tool points), frames
a map             map (what the robot reaches, of `ikgrad map`)
a training run    learning (curves with their range over members), methods and speed of its evaluation;
                  several runs are drawn together, those that differ by the seed as one curve with its range
a study           DIR or JSON of `ikgrad reproduce`: its figures
                  apps: convergence, path, learning_rate, iterations    puma: learning, errors, path
                  denso: drift, figure04 ... figure14    trajectory: sweep, joints, errors, path
an evaluation     JSON of `ikgrad evaluate`: methods (percentiles of the errors), speed (error against time)
a benchmark       JSON of `ikgrad bench`: times
a robot           built-in name or URDF file: arm (with its frames; --q turns it)"""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "plot",
        help="the right figure for a file or a training run",
        description=DESCRIPTION + LINES,
        epilog=example(
            "ikgrad plot joints.csv -o errors.png\n"
            "ikgrad plot joints.csv --robot panda --kind workspace -o where.svg\n"
            "ikgrad plot runs/panda_seed0 runs/panda_seed1 -o learning.png"
        ),
    )
    parser.add_argument("inputs", nargs="+", metavar="INPUT", help="file, folder, or built-in robot")
    text = "PNG or SVG, by suffix (default: <input>_<kind>.png in this folder)"
    parser.add_argument("-o", "--output", metavar="FIGURE", help=text)
    parser.add_argument("--kind", metavar="KIND", help="another figure than the default, see above")
    add_robot_options(parser, required=False)
    parser.add_argument("--q", type=numbers, metavar="Q1,Q2,...", help="joints of a robot that is drawn [rad or m]")
    parser.add_argument("--dpi", type=count, default=150, metavar="N", help="pixels per inch of a PNG (150)")
    parser.add_argument("--force", action="store_true", help="overwrite FIGURE")
    parser.add_argument("--json", action="store_true", help="print what was drawn as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Recognise, draw, write."""
    from ikgrad.files.places import check_output
    from ikgrad.plots.families import recognise
    from ikgrad.plots.style import SUFFIXES, save_figure

    if (args.base or args.tip) and not args.robot:
        raise ConfigError("--base and --tip need --robot")
    found = recognise(args.inputs)
    kind = found.choose(args.kind)
    name = Path(args.inputs[0]).resolve().name if Path(args.inputs[0]).exists() else args.inputs[0]
    output = check_output(
        args.output or f"{Path(name).stem}_{kind}.png", SUFFIXES, force=args.force, inputs=args.inputs
    )
    figure = found.draw(kind, _options(args, found))
    save_figure(figure, output, dpi=args.dpi, force=args.force)
    others = [other for other in found.figures if other != kind]
    if args.json:
        document = {"inputs": args.inputs, "family": found.family.what.partition(" ")[2], "kind": kind}
        print_json({**document, "kinds": list(found.figures), "output": str(output)})
        return 0
    more = f"; --kind also draws {', '.join(others)}" if others else ""
    print(f"{found.family.what}, {kind} -> {output}{more}")
    return 0


def _options(args: argparse.Namespace, found: Recognised) -> Options:
    import torch

    from ikgrad.kinematics import check_q
    from ikgrad.plots.families import Options
    from ikgrad.robot import load_robot

    drawn = args.robot or (args.inputs[0] if found.family.what == "a robot" else None)
    robot: Robot | None = load_robot(drawn, base=args.base, tip=args.tip) if drawn else None
    if args.q is None:
        return Options(robot)
    if robot is None:
        raise ConfigError("--q turns the joints of a robot that is drawn; give a robot")
    q = torch.tensor(args.q, dtype=torch.float64)
    check_q(robot, q)
    return Options(robot, q)
