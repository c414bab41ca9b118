"""``ikgrad reproduce apps``."""

from __future__ import annotations

import argparse

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, check_outputs, output_folder, present, study_progress

FILES = ("apps_convergence.png", "apps_path.png", "apps_learning_rate.png", "apps_iterations.png", "apps.json")


def add(papers: Commands) -> None:
    """Add the paper."""
    text = "inverse kinematics by back-propagation on the KUKA KR 210 (APPS)"
    parser = papers.add_parser("apps", help=text, description=text, epilog=example("ikgrad reproduce apps --out out"))
    add_options(parser, "apps")
    parser.add_argument("--config", metavar="FILE", help="YAML file with other settings of the study")
    parser.add_argument("--starts", type=count, metavar="N", help="random starts (default 1000)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    from dataclasses import replace

    from ikgrad.config import AppsConfig, load_config

    config = load_config(AppsConfig, args.config) if args.config else AppsConfig()
    if args.starts is not None:
        config = replace(config, random_starts=args.starts)
    with output_folder(args.out):
        outputs = check_outputs(args.out, FILES, force=args.force)

        from ikgrad.papers.apps.figures import FIGURES
        from ikgrad.papers.apps.report import report
        from ikgrad.papers.apps.study import run_study

        with study_progress("apps", "parts") as show:
            study = run_study(config, progress=show)
        present(study, report(study), outputs, FIGURES, as_json=args.json)
    return 0
