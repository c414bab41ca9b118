"""``ikgrad reproduce puma``."""

from __future__ import annotations

import argparse
import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.reproduce.shared import add_options, check_outputs, output_folder, present, study_progress
from ikgrad.cli.terminal import Interrupted

if TYPE_CHECKING:
    from ikgrad.config import PumaConfig

FILES = ("puma_learning.png", "puma_errors.png", "puma_path.png", "puma.json")
FULL = 1_000_000  # the paper's N
CHECKPOINTS = "puma_checkpoints"


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
    parser.add_argument("--resume", action="store_true", help="go on with the run that was cut off in DIR")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    config = _config(args)
    with output_folder(args.out):
        outputs = check_outputs(args.out, FILES, force=args.force)
        with _checkpoints(args) as checkpoints:
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


@contextlib.contextmanager
def _checkpoints(args: argparse.Namespace) -> Iterator[Path | None]:
    """The folder of checkpoints, gone when the study is done, kept when it is cut off."""
    from ikgrad.errors import ConfigError, DataError

    if args.out is None:
        if args.resume:
            raise ConfigError("--resume needs --out DIR, the folder of the run that was cut off")
        yield None
        return
    folder = Path(args.out) / CHECKPOINTS
    if folder.exists() and not args.resume:
        if not args.force:
            raise DataError(f"{folder}: a run was cut off here; --resume goes on with it, --force starts anew")
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    try:
        yield folder
    except BaseException as error:
        with contextlib.suppress(OSError):  # not empty: there is something to go on with
            folder.rmdir()
        if isinstance(error, KeyboardInterrupt) and folder.exists():
            raise Interrupted(
                f"interrupted; the same command with --resume goes on (checkpoints in {folder})"
            ) from error
        raise
    shutil.rmtree(folder)
