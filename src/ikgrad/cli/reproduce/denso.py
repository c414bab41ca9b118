"""``ikgrad reproduce denso``."""

from __future__ import annotations

import argparse

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, add_resume, configured, reproduce

FIGURES = ("figure04", "figure06", "figure11", "figure12", "figure13", "figure14", "drift")
FILES = (*(f"denso_{name}.png" for name in FIGURES), "denso.json", "denso_study.npz")


def add(papers: Commands) -> None:
    """Add the paper."""
    text = "two networks for the inverse kinematics of a Denso VP6242, and the closed loop"
    parser = papers.add_parser(
        "denso", help=text, description=text, epilog=example("ikgrad reproduce denso --seeds 3 --out out")
    )
    add_options(parser, "denso")
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings, such as configs/denso.yaml")
    parser.add_argument(
        "--seeds", type=count, metavar="N", help="networks of each kind on schemes B and D (default 10)"
    )
    parser.add_argument("--epochs", type=count, metavar="N", help="epochs on schemes A, C and D (default 300)")
    add_resume(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study."""
    from ikgrad.config import DensoConfig

    return reproduce(args, configured(DensoConfig, args, "epochs", "seeds"), FILES, resumable=True)
