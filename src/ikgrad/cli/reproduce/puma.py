"""``ikgrad reproduce puma``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, add_resume, reproduce, with_options

if TYPE_CHECKING:
    from ikgrad.config import PumaConfig

FILES = ("puma_learning.png", "puma_errors.png", "puma_path.png", "puma.json", "puma_study.npz")
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
    """Run the study."""
    return reproduce(args, _config(args), FILES, unit="steps", resumable=True, races=args.races)


def _config(args: argparse.Namespace) -> PumaConfig:
    from ikgrad.config import PumaConfig, RuleConfig, load_config
    from ikgrad.errors import ConfigError

    if args.full and args.epochs is not None:
        raise ConfigError(f"--full means --epochs {FULL}; give one of the two")
    config = PumaConfig(rules=tuple(load_config(RuleConfig, file) for file in args.config or ()))
    return with_options(config, {"epochs": FULL if args.full else args.epochs, "seeds": args.seeds})
