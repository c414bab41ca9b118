"""``ikgrad train``: an inverter, from settings to weights, in a folder that survives being killed."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli import train_stream
from ikgrad.cli.parsing import Commands, example, positive
from ikgrad.cli.terminal import Interrupted, Progress, duration, print_json, print_table, stop_between_steps
from ikgrad.config.training import AnyConfig, TrainConfig
from ikgrad.errors import ConfigError, IkgradError

if TYPE_CHECKING:
    from ikgrad.training.stream_result import StreamResult
    from ikgrad.training.train import TrainProgress, TrainResult

Fields = dict[str, dataclasses.Field[Any]]

DESCRIPTION = """\
train a neural inverter for any robot: settings from a file, from options, or from both; an option wins over the file.

--model unrolled (the default) holds the arm's own kinematics and corrects it, increment is a plain network; both start
from the present joints, learn for --minutes from samples without end, and are measured on fresh ones beside plain
damped steps. --model classic is a small network that learns a data set.

Values of options are written as in YAML: --spread null, --hidden "[20, 20]", --data "{scheme: cube, count: 8000}".
The run folder holds config.yaml, run.json, history.csv and model/ (model-0/, model-1/ ... for several members).
Ctrl-C ends with a checkpoint and exit status 130; after that, or after a kill, the same command with --resume goes on,
with the time that is left, or to the same weights as a run that was left alone where the budget is one of steps or
epochs. The checkpoint goes when the run is finished. Several processes, models unrolled and increment:
torchrun --nproc-per-node 2 -m ikgrad train ..."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "train",
        help="train a neural inverter",
        description=DESCRIPTION,
        epilog=example(
            "ikgrad train --robot panda\n"
            "ikgrad train --robot arm.urdf --tip tool0 --minutes 15 --out runs/arm\n"
            "ikgrad train --config denso_feedback --hidden [20] --seed 3 --out runs/denso"
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
    """One option for every key of any model."""
    from ikgrad.config import StreamConfig, TrainConfig

    stream, classic = ({field.name: field for field in dataclasses.fields(cls)} for cls in (StreamConfig, TrainConfig))
    for title, keys in (
        ("settings of every model", [key for key in stream if key in classic]),
        ("settings of the models unrolled and increment", [key for key in stream if key not in classic]),
        ("settings of the model classic", [key for key in classic if key not in stream]),
    ):
        group = parser.add_argument_group(title, "every key of the file, with its default")
        for key in keys:
            group.add_argument(_option(key), dest=f"set_{key}", metavar="YAML", help=_help(key, stream, classic))


def _help(key: str, stream: Fields, classic: Fields) -> str:
    from ikgrad.config import StreamConfig, TrainConfig
    from ikgrad.config.loading import describe_keys

    text = describe_keys(StreamConfig if key in stream else TrainConfig)[key]
    defaults = [_default(fields[key]) for fields in (stream, classic) if key in fields]
    if len(set(defaults)) == 2 and key != "model":
        return f"{text} ({defaults[0]}; classic: {defaults[1]})"
    return f"{text} ({defaults[0]})"


def run(args: argparse.Namespace) -> int:
    """Train, show how it goes, print what came of it; all mistakes are found before the work starts."""
    if os.environ.get("RANK", "0") != "0":  # of torchrun
        with _silence():
            _train(args, *_settings(args), None)
        return 0
    config, out = _settings(args)
    with _progress(config, out) as progress:
        result = _train(args, config, out, progress)
    from ikgrad.training.stream_result import StreamResult

    if isinstance(result, StreamResult):
        found = train_stream.measure(result)
        train_stream.keep(result, found)
        if args.json:
            print_json(train_stream.document(result, found))
        else:
            train_stream.show(result, found)
        return 0
    if args.json:
        print_json(_document(result))
    else:
        _print(result)
    return 0


def _train(
    args: argparse.Namespace, config: AnyConfig, out: Path, progress: Callable[[Any], None] | None
) -> TrainResult | StreamResult:
    from ikgrad.training.train import train

    return train(
        config,
        out=out,
        resume=args.resume,
        force=args.force,
        progress=progress,
        checkpoint_seconds=args.checkpoint_seconds,
    )


def _settings(args: argparse.Namespace) -> tuple[AnyConfig, Path]:
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
def _silence() -> Iterator[None]:
    """In all processes but the first: nothing is told, Ctrl-C waits for the first, which speaks of mistakes, too."""
    with stop_between_steps():
        try:
            yield
        except IkgradError:
            raise SystemExit(2) from None
        except KeyboardInterrupt:
            raise SystemExit(130) from None


@contextlib.contextmanager
def _progress(config: AnyConfig, out: Path) -> Iterator[Callable[[Any], None]]:
    """A function to be called between steps; Ctrl-C waits for it, so that the checkpoint is whole."""
    curve = _Epochs(config) if isinstance(config, TrainConfig) else train_stream.LiveCurve(config)
    with curve, stop_between_steps() as stop_if_asked:

        def show(now: Any) -> None:
            curve.show(now)
            stop_if_asked()

        try:
            yield show
        except KeyboardInterrupt:
            checkpoint = out / "checkpoint"
            advice = (
                f"the same command with --resume goes on (checkpoint in {checkpoint})"
                if checkpoint.exists()
                else "there is no checkpoint yet; the same command with --resume starts anew"
            )
            raise Interrupted(f"interrupted {curve.where}; {advice}") from None


class _Epochs(Progress):
    """Progress of the model classic."""

    def __init__(self, config: TrainConfig):
        super().__init__("train", config.epochs, "epochs")
        self.robot, self._begun = config.robot, False

    @property
    def where(self) -> str:
        """How far it has come, for the line that Ctrl-C prints."""
        return f"after {self.done:,} of {self.total:,} epochs" if self.done else "before the first epoch"

    def show(self, now: TrainProgress) -> None:
        """Take the state after an epoch."""
        if not self._begun:  # maybe in the middle of a resumed run
            self.skip(now.done - 1)
            self._begun = True
        losses = f"loss {now.train:.3g}"
        if now.validation is not None:
            losses += f", validation {now.validation:.3g}"
        self.what, self.total = f"train {self.robot}: {losses}", now.total
        self.advance(now.done - self.done)


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
