"""``ikgrad reproduce puma``."""

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
    from ikgrad.config import PumaConfig

FILES = ("puma_learning.png", "puma_errors.png", "puma_path.png", "puma.json")
FULL = 1_000_000  # the paper's N


def add(papers: Commands) -> None:
    """Add the paper."""
    text = "five training rules for the inverse kinematics of a PUMA 560"
    parser = papers.add_parser(
        "puma", help=text, description=text, epilog=example("ikgrad reproduce puma --seeds 4 --out out")
    )
    add_options(parser, "puma")
    parser.add_argument(
        "--config",
        metavar="FILE",
        action="append",
        help="YAML file of a rule, such as configs/puma_qp.yaml; repeat it for several (default: the paper's five)",
    )
    parser.add_argument("--epochs", type=count, metavar="N", help="epochs of every rule (default 111111)")
    parser.add_argument("--full", action="store_true", help=f"the paper's {FULL} epochs")
    parser.add_argument("--seeds", type=count, metavar="N", help="networks of every rule (default 16)")
    parser.add_argument(
        "--races", action="store_true", help="also race the rules against Rprop, Adam, L-BFGS and others (minutes)"
    )
    add_resume(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    config = _config(args)
    with output_folder(args.out):
        outputs = check_outputs(args.out, FILES, force=args.force)
        with checkpoint_folder(args) as checkpoints:
            from ikgrad.papers.puma.figures import FIGURES
            from ikgrad.papers.puma.report import report
            from ikgrad.papers.puma.study import run_study

            with study_progress("puma", "steps", finish_step=True) as show:
                study = run_study(config, races=args.races, checkpoints=checkpoints, progress=show)
            present(study, report(study), outputs, FIGURES, as_json=args.json)
    return 0


def _config(args: argparse.Namespace) -> PumaConfig:
    from dataclasses import replace

    from ikgrad.config import PumaConfig, RuleConfig, load_config
    from ikgrad.errors import ConfigError

    if args.full and args.epochs is not None:
        raise ConfigError(f"--full means --epochs {FULL}; give one of the two")
    config = PumaConfig(rules=tuple(load_config(RuleConfig, file) for file in args.config or ()))
    epochs = FULL if args.full else args.epochs
    given = {"epochs": epochs, "seeds": args.seeds}
    return replace(config, **{key: value for key, value in given.items() if value is not None})
