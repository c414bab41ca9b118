"""What the papers' commands share: options, tables, the output folder, progress."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ikgrad.cli.terminal import Interrupted, Progress, note, print_json, print_table, stop_between_steps

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from ikgrad.papers.record import Table

C = TypeVar("C", bound="DataclassInstance")


def add_options(parser: argparse.ArgumentParser, paper: str) -> None:
    """The options that every paper has."""
    parser.add_argument("--json", action="store_true", help="print the same numbers as one JSON document")
    parser.add_argument("--out", metavar="DIR", help=f"folder for the figures and {paper}.json; made if it is missing")
    parser.add_argument("--force", action="store_true", help="overwrite existing files in DIR")


def add_resume(parser: argparse.ArgumentParser) -> None:
    """The option of papers whose trainings leave checkpoints, see `checkpoint_folder`."""
    parser.add_argument("--resume", action="store_true", help="go on with the run that was cut off in DIR")


def configured(config: type[C], args: argparse.Namespace, *keys: str) -> C:
    """Settings of a paper: its own, or those of ``--config``, changed by the options of these names."""
    from ikgrad.config import load_config

    settings = load_config(config, args.config) if args.config else config()
    return with_options(settings, {key: getattr(args, key) for key in keys})


def with_options(config: C, options: Mapping[str, Any]) -> C:
    """Settings changed by the options that were given."""
    return dataclasses.replace(config, **{key: value for key, value in options.items() if value is not None})


def reproduce(
    args: argparse.Namespace,
    config: Any,
    files: Iterable[str],
    *,
    unit: str = "epochs",
    finish_step: bool = True,
    resumable: bool = False,
    **settings: Any,
) -> int:
    """Run a study, print it, and write its figures; all mistakes are found before the work starts.

    Every paper is a package of the same make: ``study.run_study``, ``report.report`` and ``figures.FIGURES``.

    Args:
        args: of the command line.
        config: of the study.
        files: to be written, if there is a folder.
        unit: of progress.
        finish_step: see `study_progress`.
        resumable: the study keeps checkpoints.
        settings: further arguments of ``run_study``.
    """
    with output_folder(args.out):
        outputs = check_outputs(args.out, files, force=args.force)
        with checkpoint_folder(args) if resumable else contextlib.nullcontext() as checkpoints:
            if resumable:
                settings["checkpoints"] = checkpoints
            parts = (import_module(f"ikgrad.papers.{args.paper}.{part}") for part in ("study", "report", "figures"))
            study_of, report_of, figures_of = parts
            with study_progress(args.paper, unit, finish_step=finish_step) as show:
                study = study_of.run_study(config, progress=show, **settings)
            present(study, report_of.report(study), outputs, figures_of.FIGURES, as_json=args.json)
    return 0


def print_report(tables: Iterable[Table]) -> None:
    """All tables on stdout."""
    for table in tables:
        print_table(table.title, table.columns, table.rows, right=range(table.left, len(table.columns)))


def present(
    study: Any,
    tables: Iterable[Table],
    outputs: Mapping[str, Path],
    figures: Mapping[str, Callable[[Any], Any]],
    *,
    as_json: bool,
) -> None:
    """A finished study on stdout, as tables or as one JSON document, and its files."""
    if as_json:
        print_json(study.to_json())
    else:
        print_report(tables)
    write_outputs(study, outputs, figures)


def check_outputs(folder: str | None, names: Iterable[str], *, force: bool) -> dict[str, Path]:
    """The files to be written, by what they show; none without a folder.

    Raises:
        DataError: one of them exists, or the folder is not writable.
    """
    from ikgrad.files.places import check_output

    if folder is None:
        return {}
    paths = (Path(folder) / name for name in names)
    return {path.stem: check_output(path, [".png", ".json", ".npz"], force=force) for path in paths}


def write_outputs(study: Any, outputs: Mapping[str, Path], figures: Mapping[str, Callable[[Any], Any]]) -> None:
    """Figures and numbers of a study; every file appears whole."""
    from ikgrad.files.places import in_one_move
    from ikgrad.papers.store import save_study
    from ikgrad.plots import save_figure

    for name, path in outputs.items():
        if path.suffix == ".png":
            save_figure(figures[name](study), path)
            continue
        with in_one_move(path, force=True) as temporary:
            if path.suffix == ".npz":
                save_study(study, temporary)
                continue
            temporary.write_text(json.dumps(study.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if outputs:
        note(f"wrote {', '.join(path.name for path in outputs.values())} to {next(iter(outputs.values())).parent}")


@contextlib.contextmanager
def output_folder(name: str | None) -> Iterator[None]:
    """Make the folder if it is missing (its parent must exist), and take it away again if nothing comes of it."""
    from ikgrad.errors import DataError

    folder = Path(name or ".")
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder}: is a file, not a folder")
    if not folder.absolute().parent.is_dir():
        raise DataError(f"{folder}: the folder '{folder.parent}' does not exist; create it first")
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if made:
            with contextlib.suppress(OSError):  # not empty: some files were written
                folder.rmdir()
        raise


@contextlib.contextmanager
def checkpoint_folder(args: argparse.Namespace) -> Iterator[Path | None]:
    """The folder of a paper's checkpoints, gone when the study is done, kept when it is cut off; None without --out.

    Raises:
        ConfigError: --resume without --out.
        DataError: a run was cut off here, and neither --resume nor --force says what to do with it.
    """
    from ikgrad.errors import ConfigError, DataError

    if args.out is None:
        if args.resume:
            raise ConfigError("--resume needs --out DIR, the folder of the run that was cut off")
        yield None
        return
    folder = Path(args.out) / f"{args.paper}_checkpoints"
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


@contextlib.contextmanager
def study_progress(paper: str, unit: str, *, finish_step: bool = False) -> Iterator[Any]:
    """Progress of a study, as a function (label, done, total).

    Args:
        paper: shown at the start.
        unit: of ``done`` and ``total``.
        finish_step: raise Ctrl-C from that function, between two steps of the work, and not in the middle of one.
    """
    stop = stop_between_steps() if finish_step else contextlib.nullcontext(lambda: None)
    with Progress(f"reproduce {paper}", 0, unit) as progress, stop as stop_if_asked:

        def show(label: str, done: int, total: int) -> None:
            progress.what, progress.total = label, total
            progress.advance(done - progress.done)
            stop_if_asked()

        yield show
