"""``ikgrad robots``: the built-in robots, or one robot in detail."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from ikgrad.cli.parsing import Commands, add_robot_options, example
from ikgrad.cli.terminal import print_json, print_table

if TYPE_CHECKING:
    from ikgrad.robot import Robot
    from ikgrad.segments import Variable


def add(commands: Commands) -> None:
    """Add the command."""
    text = "list the built-in robots, or show the joints of one robot"
    parser = commands.add_parser(
        "robots", help=text, description=text, epilog=example("ikgrad robots\nikgrad robots --robot panda")
    )
    add_robot_options(parser, required=False)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the table of robots, or of the joints of one."""
    from ikgrad.errors import ConfigError
    from ikgrad.resources import builtin_names
    from ikgrad.robot import load_robot

    if args.robot is not None:
        robot = load_robot(args.robot, base=args.base, tip=args.tip)
        print_json(record(robot)) if args.json else _print_one(robot)
        return 0
    if args.base or args.tip:
        raise ConfigError("--base and --tip need --robot")
    loaded = {name: load_robot(name) for name in builtin_names("urdf")}
    if args.json:
        print_json([{**record(robot), "name": name} for name, robot in loaded.items()])
        return 0
    rows = [
        [name, str(robot.dof), f"{robot.base} -> {robot.tip}", _reach(robot), ", ".join(map(_range, robot.variables))]
        for name, robot in loaded.items()
    ]
    title = "Built-in robots; any URDF file works as well (--robot arm.urdf)"
    print_table(title, ["name", "joints", "base -> tip", "reach", "limits [deg, or m for slides]"], rows, right=(1, 3))
    return 0


def record(robot: Robot) -> dict[str, Any]:
    """A robot for a program: SI units, null where a joint has no limit."""
    joints = [{"name": v.name, "kind": v.kind, "q_min": v.q_min, "q_max": v.q_max} for v in robot.variables]
    return {
        "name": robot.name,
        "dof": robot.dof,
        "base": robot.base,
        "tip": robot.tip,
        "reach_bound_m": robot.reach_bound,
        "fingerprint": robot.fingerprint,
        "joints": joints,
    }


def joint_list(robot: Robot) -> str:
    """Joint names with units, for messages."""
    return ", ".join(f"{v.name} [{'rad' if v.kind == 'revolute' else 'm'}]" for v in robot.variables)


def _print_one(robot: Robot) -> None:
    rows = [[v.name, v.kind, *(_limit(v, x) for x in v[2:]), _unit(v)] for v in robot.variables]
    title = f"{robot.name}: {robot.dof} joints, {robot.base} -> {robot.tip}, reach {_reach(robot)}"
    print_table(title, ["joint", "kind", "min", "max", "unit"], rows, right=(2, 3))


def _unit(variable: Variable) -> str:
    return "deg" if variable.kind == "revolute" else "m"


def _limit(variable: Variable, value: float, digits: int = 6) -> str:
    if not math.isfinite(value):
        return "none"
    shown = math.degrees(value) if variable.kind == "revolute" else value
    return f"{shown:.{digits}g}"


def _range(variable: Variable) -> str:
    low, high = (_limit(variable, value, 4) for value in variable[2:])
    if low == high == "none":
        return "unlimited"
    return f"±{high}" if low == f"-{high}" else f"{low}..{high}"


def _reach(robot: Robot) -> str:
    """No pose farther than this from the first joint can be reached (the arm laid out straight)."""
    return f"<= {robot.reach_bound:.3g} m" if math.isfinite(robot.reach_bound) else "unlimited"
