"""Inverters that a command line names: a run folder, the folder of one inverter, or a ready-made name."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ikgrad.networks.storage import AnyInverter


def add_inverter_options(parser: argparse.ArgumentParser) -> None:
    """``RUN``, and the robot that it is for."""
    text = "run folder of `ikgrad train`, folder of one inverter, or the name of a ready-made one"
    parser.add_argument("run_folder", metavar="RUN", help=text)
    parser.add_argument("--robot", metavar="ROBOT", help="the robot, if it is not built in: path of its URDF file")
    parser.add_argument("--base", metavar="LINK", help="its base link")
    parser.add_argument("--tip", metavar="LINK", help="its tip link")


def load(args: argparse.Namespace) -> AnyInverter:
    """The inverter.

    Raises:
        DataError: there is none, or there are several.
        RobotError: it belongs to another robot.
        ConfigError: ``--base`` or ``--tip`` without ``--robot``.
    """
    from ikgrad.errors import ConfigError
    from ikgrad.networks import load_inverter
    from ikgrad.robot import load_robot

    if (args.base or args.tip) and not args.robot:
        raise ConfigError("--base and --tip need --robot")
    robot = load_robot(args.robot, base=args.base, tip=args.tip) if args.robot else None
    return load_inverter(args.run_folder, robot=robot)
