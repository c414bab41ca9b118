"""``ikgrad reproduce trajectory``."""

from __future__ import annotations

import argparse

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, configured, reproduce

FIGURES = ("joints", "errors", "path", "sweep")
FILES = (*(f"trajectory_{name}.png" for name in FIGURES), "trajectory.json", "trajectory_study.npz")


def add(papers: Commands) -> None:
    """Add the paper."""
    text = "a network that knows the trajectory of a 4-DOF arm, and its links against an obstacle"
    parser = papers.add_parser(
        "trajectory", help=text, description=text, epilog=example("ikgrad reproduce trajectory --seeds 3 --out out")
    )
    add_options(parser, "trajectory")
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings, such as configs/trajectory.yaml")
    parser.add_argument("--seeds", type=count, metavar="N", help="networks of each kind (default 5)")
    parser.add_argument("--epochs", type=count, metavar="N", help="per pattern, of the hand's network (default 10000)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study."""
    from ikgrad.config import TrajectoryConfig

    return reproduce(args, configured(TrajectoryConfig, args, "epochs", "seeds"), FILES)
