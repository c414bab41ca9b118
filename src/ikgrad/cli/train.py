"""``ikgrad train``: an inverter, from settings to weights, in a folder that survives being killed."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.parsing import Commands, example, positive
from ikgrad.cli.terminal import Interrupted, Progress, duration, print_json, print_table, stop_between_steps
from ikgrad.errors import ConfigError

if TYPE_CHECKING:
    from ikgrad.config import TrainConfig
    from ikgrad.training.train import TrainProgress, TrainResult

DESCRIPTION = """\
train a neural inverter: settings from a file, from options, or from both; an option wins over the file.

Values of options are written as in YAML: --hidden "[20, 20]", --lr 1e-3, --patience null,
--data "{scheme: cube, half_width: 0.03}". --data "{count: 8000}" changes that key of the file's data only.
The run folder holds config.yaml, run.json, history.csv and model/ (model-0/, model-1/ ... for several members).
Ctrl-C ends with a checkpoint and exit status 130; after that, or after a kill, the same command with --resume goes on
and ends with the same weights as a run that was left alone. The checkpoint goes when the run is finished."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "train",
        help="train a neural inverter",
        description=DESCRIPTION,
        epilog=example(
            "ikgrad train --config denso_feedback --hidden [20] --seed 3 --out runs/denso\n"
            "ikgrad train --robot panda --feedback true --optimizer Adam --lr 1e-3 --batch-size 256 --out runs/panda"
        ),
    )
    parser.add_argument("--config", metavar="FILE", help="YAML file, or a built-in name such as denso_feedback")
    parser.add_argument("--out", metavar="DIR", help="run folder to make (default: runs/<config or robot>_seed<seed>)")
    parser.add_argument("--resume", action="store_true", help="go on with the run in DIR; alone, with its settings")
    parser.add_argument("--force", action="store_true", help="replace the run in DIR")
    parser.add_argument(
        "--checkpoint-seconds", type=positive, default=30.0, metavar="S", help="time between checkpoints (30)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
    _add_settings(parser)
    parser.set_defaults(run=run)


def _add_settings(parser: argparse.ArgumentParser) -> None:
    """One option for every key."""
    from ikgrad.config import TrainConfig
    from ikgrad.config.loading import describe_keys

    help_of = describe_keys(TrainConfig)
    group = parser.add_argument_group("settings", "every key of the file, with its default")
    for field in dataclasses.fields(TrainConfig):
        group.add_argument(
            _option(field.name),
            dest=f"set_{field.name}",
            metavar="YAML",
            help=f"{help_of.get(field.name, '')} ({_default(field)})",
        )


def run(args: argparse.Namespace) -> int:
    """Train, show how it goes, print what came of it; all mistakes are found before the work starts."""
    config, out = _settings(args)
    from ikgrad.training import train

    with _progress(config, out) as show:
        result = train.train(
            config,
            out=out,
            resume=args.resume,
            force=args.force,
            progress=show,
            checkpoint_seconds=args.checkpoint_seconds,
        )
    if args.json:
        print_json(_document(result))
    else:
        _print(result)
    return 0


def _settings(args: argparse.Namespace) -> tuple[TrainConfig, Path]:
    from ikgrad.config.loading import parse_value
    from ikgrad.config.training import train_config
    from ikgrad.resources import find_config

    if args.resume and args.force:
        raise ConfigError("--resume goes on with a run and --force replaces it; give one of the two")
    given = {key[4:]: text for key, text in vars(args).items() if key.startswith("set_") and text is not None}
    options = {key: parse_value(text, where=_option(key)) for key, text in given.items()}
    source: Path | None = find_config(args.config) if args.config else None
    if source is None and args.resume and args.out and (Path(args.out) / "config.yaml").is_file():
        source = Path(args.out) / "config.yaml"
    config = train_config(source, options)
    name = Path(args.config or config.robot).stem
    return config, Path(args.out or f"runs/{name}_seed{config.seed}")


@contextlib.contextmanager
def _progress(config: TrainConfig, out: Path) -> Iterator[Callable[[TrainProgress], None]]:
    """A function to be called between epochs; Ctrl-C waits for it, so that the checkpoint is whole."""
    begun = False
    with Progress("train", config.epochs, "epochs") as progress, stop_between_steps() as stop_if_asked:

        def show(now: TrainProgress) -> None:
            nonlocal begun
            if not begun:  # maybe in the middle of a resumed run
                progress.skip(now.done - 1)
                begun = True
            losses = f"loss {now.train:.3g}"
            if now.validation is not None:
                losses += f", validation {now.validation:.3g}"
            progress.what, progress.total = f"train {config.robot}: {losses}", now.total
            progress.advance(now.done - progress.done)
            stop_if_asked()

        try:
            yield show
        except KeyboardInterrupt:
            done = (
                f"after {progress.done:,} of {progress.total:,} epochs" if progress.total else "before the first epoch"
            )
            checkpoint = out / "checkpoint"
            advice = (
                f"the same command with --resume goes on (checkpoint in {checkpoint})"
                if checkpoint.exists()
                else "there is no checkpoint yet; the same command with --resume starts anew"
            )
            raise Interrupted(f"interrupted {done}; {advice}") from None


def _print(result: TrainResult) -> None:
    columns = ["seed", "epochs", "kept", "validation", "test", "position [mm]", "rotation [deg]"]
    rows = []
    for member in result.members:
        row = [f"{member.seed}", f"{member.epochs}", f"{member.best_epoch}", f"{member.best_loss:.3g}"]
        if member.test is None:
            row += ["-", "-", "-"]
        else:
            spreads = (member.test.position_mm, member.test.rotation_deg)
            row += [f"{member.test.joint_mse:.3g}", *(" / ".join(f"{x:.3g}" for x in spread) for spread in spreads)]
        rows.append(row)
    config = result.config
    kind = "feedback" if config.feedback else "traditional"
    sizes = "-".join(str(units) for units in result.inverter.network.sizes)
    title = (
        f"ikgrad train: {result.inverter.robot.name}, {kind}, {sizes}, {config.optimizer}\n"
        "validation, test: mean squared joint error [rad^2, m^2 for slides]; position, rotation: error of the tip on "
        "the test rows, median / 95 % / worst"
    )
    print_table(title, columns, rows, right=range(len(columns)))
    for member in result.members:
        if member.diverged_at:
            print(f"seed {member.seed}: the loss was not finite after epoch {member.diverged_at}.")
    print(f"{duration(result.seconds)}; written to {result.folder}")


def _document(result: TrainResult) -> dict[str, Any]:
    return {
        "robot": result.inverter.robot.name,
        "config": vars(result.config),
        "seconds": result.seconds,
        "members": [dataclasses.asdict(member) for member in result.members],
        "out": str(result.folder),
    }


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _default(field: dataclasses.Field[Any]) -> str:
    value = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    if value == "":
        return "must be given"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(list(value)) if isinstance(value, tuple) else str(value).replace("'", "")
