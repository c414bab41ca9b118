"""``ikgrad reproduce``: the tables and figures of the papers."""

from __future__ import annotations

import argparse

from ikgrad.cli.parsing import Commands, count, example


def add(commands: Commands) -> None:
    """Add the command and its papers."""
    text = "reproduce a paper: its tables beside ours, its figures"
    parser = commands.add_parser(
        "reproduce", help=text, description=text, epilog=example("ikgrad reproduce apps --out out")
    )
    papers = parser.add_subparsers(dest="paper", metavar="PAPER", required=True, title="papers")
    text = "inverse kinematics by back-propagation on the KUKA KR 210 (APPS)"
    apps = papers.add_parser("apps", help=text, description=text, epilog=example("ikgrad reproduce apps --out out"))
    apps.add_argument("--json", action="store_true", help="print the same numbers as one JSON document")
    apps.add_argument("--out", metavar="DIR", help="folder for figures and tables")
    apps.add_argument("--config", metavar="FILE", help="YAML file with other settings of the study")
    apps.add_argument("--starts", type=count, default=1000, metavar="N", help="random starts (default 1000)")
    apps.add_argument("--force", action="store_true", help="overwrite existing files in DIR")
    apps.set_defaults(run=run_apps)


def run_apps(args: argparse.Namespace) -> int:
    """Run the study."""
    import importlib

    status: int = importlib.import_module("ikgrad.papers.apps").main(args)
    return status
