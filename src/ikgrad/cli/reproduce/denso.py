"""``ikgrad reproduce denso``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import (
    add_options,
    add_resume,
    check_outputs,
    checkpoint_folder,
    output_folder,
    present,
    study_progress,
)

if TYPE_CHECKING:
    from ikgrad.config import DensoConfig

FIGURES = ("figure04", "figure06", "figure11", "figure12", "figure13", "figure14", "drift")
FILES = (*(f"denso_{name}.png" for name in FIGURES), "denso.json")


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
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    config = _config(args)
    with output_folder(args.out):
        outputs = check_outputs(args.out, FILES, force=args.force)
        with checkpoint_folder(args) as checkpoints:
            from ikgrad.papers.denso.figures import FIGURES
            from ikgrad.papers.denso.report import report
            from ikgrad.papers.denso.study import run_study

            with study_progress("denso", "epochs", finish_step=True) as show:
                study = run_study(config, checkpoints=checkpoints, progress=show)
            present(study, report(study), outputs, FIGURES, as_json=args.json)
    return 0


def _config(args: argparse.Namespace) -> DensoConfig:
    from dataclasses import replace

    from ikgrad.config import DensoConfig, load_config

    config = load_config(DensoConfig, args.config) if args.config else DensoConfig()
    given = {"epochs": args.epochs, "seeds": args.seeds}
    return replace(config, **{key: value for key, value in given.items() if value is not None})
