"""``ikgrad reproduce apps``."""

from __future__ import annotations

import argparse

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, configured, reproduce

FILES = (
    "apps_convergence.png",
    "apps_path.png",
    "apps_learning_rate.png",
    "apps_iterations.png",
    "apps.json",
    "apps_study.npz",
)


def add(papers: Commands) -> None:
    """Add the paper."""
    text = "inverse kinematics by back-propagation on the KUKA KR 210 (APPS)"
    parser = papers.add_parser("apps", help=text, description=text, epilog=example("ikgrad reproduce apps --out out"))
    add_options(parser, "apps")
    parser.add_argument("--config", metavar="FILE", help="YAML file with other settings of the study")
    parser.add_argument("--starts", dest="random_starts", type=count, metavar="N", help="random starts (default 1000)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study."""
    from ikgrad.config import AppsConfig

    config = configured(AppsConfig, args, "random_starts")
    return reproduce(args, config, FILES, unit="parts", finish_step=False)
