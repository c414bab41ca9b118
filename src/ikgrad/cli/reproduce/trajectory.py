"""``ikgrad reproduce trajectory``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, check_outputs, output_folder, present, study_progress

if TYPE_CHECKING:
    from ikgrad.config import TrajectoryConfig

FIGURES = ("joints", "errors", "path", "sweep")
FILES = (*(f"trajectory_{name}.png" for name in FIGURES), "trajectory.json")


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
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    config = _config(args)
    with output_folder(args.out):
        outputs = check_outputs(args.out, FILES, force=args.force)
        from ikgrad.papers.trajectory.figures import FIGURES
        from ikgrad.papers.trajectory.report import report
        from ikgrad.papers.trajectory.study import run_study

        with study_progress("trajectory", "epochs", finish_step=True) as show:
            study = run_study(config, progress=show)
        present(study, report(study), outputs, FIGURES, as_json=args.json)
    return 0


def _config(args: argparse.Namespace) -> TrajectoryConfig:
    from dataclasses import replace

    from ikgrad.config import TrajectoryConfig, load_config

    config = load_config(TrajectoryConfig, args.config) if args.config else TrajectoryConfig()
    given = {"epochs": args.epochs, "seeds": args.seeds}
    return replace(config, **{key: value for key, value in given.items() if value is not None})
