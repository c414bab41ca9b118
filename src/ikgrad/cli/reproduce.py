"""``ikgrad reproduce``: the tables and figures of the papers."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.parsing import Commands, count, example
from ikgrad.cli.terminal import Progress, note, print_json, print_table

if TYPE_CHECKING:
    from ikgrad.papers.apps.study import AppsStudy


def add(commands: Commands) -> None:
    """Add the command and its papers."""
    text = "reproduce a paper: its tables beside ours, its figures"
    parser = commands.add_parser(
        "reproduce", help=text, description=text, epilog=example("ikgrad reproduce apps --out out")
    )
    papers = parser.add_subparsers(dest="paper", metavar="PAPER", required=True, title="papers")
    text = "inverse kinematics by back-propagation on the KUKA KR 210 (APPS)"
    apps = papers.add_parser("apps", help=text, description=text, epilog=example("ikgrad reproduce apps --out out"))
    apps.add_argument("--json", action="store_true", help="print the same numbers as one JSON document")
    apps.add_argument("--out", metavar="DIR", help="folder for the figures and apps.json; made if it is missing")
    apps.add_argument("--config", metavar="FILE", help="YAML file with other settings of the study")
    apps.add_argument("--starts", type=count, metavar="N", help="random starts (default 1000)")
    apps.add_argument("--force", action="store_true", help="overwrite existing files in DIR")
    apps.set_defaults(run=run_apps)


def run_apps(args: argparse.Namespace) -> int:
    """Run the study, print it, and write its figures; all mistakes are found before the work starts."""
    from dataclasses import replace

    from ikgrad.config import AppsConfig, load_config

    config = load_config(AppsConfig, args.config) if args.config else AppsConfig()
    if args.starts is not None:
        config = replace(config, random_starts=args.starts)
    with _folder(args.out):
        outputs = _outputs(Path(args.out), force=args.force) if args.out else {}

        from ikgrad.papers.apps.study import run_study

        with _progress() as show:
            study = run_study(config, progress=show)
        if args.json:
            print_json(study.to_json())
        else:
            _print(study)
        _write(study, outputs, force=args.force)
    if outputs:
        note(f"wrote {', '.join(path.name for path in outputs.values())} to {args.out}")
    return 0


def _print(study: AppsStudy) -> None:
    from ikgrad.papers.apps.report import report

    for table in report(study):
        print_table(table.title, table.columns, table.rows, right=range(table.left, len(table.columns)))


def _outputs(folder: Path, *, force: bool) -> dict[str, Path]:
    """The files to be written, by what they show."""
    from ikgrad.files.places import check_output

    names = ("apps_convergence.png", "apps_path.png", "apps_learning_rate.png", "apps_iterations.png", "apps.json")
    return {Path(name).stem: check_output(folder / name, [".png", ".json"], force=force) for name in names}


def _write(study: AppsStudy, outputs: dict[str, Path], *, force: bool) -> None:
    if not outputs:
        return
    from ikgrad.files.places import in_one_move
    from ikgrad.papers.apps.figures import FIGURES
    from ikgrad.plots import save_figure

    for name, path in outputs.items():
        if path.suffix == ".png":
            save_figure(FIGURES[name](study), path, force=force)
            continue
        with in_one_move(path, force=force) as temporary:
            temporary.write_text(json.dumps(study.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")


@contextlib.contextmanager
def _folder(name: str | None) -> Iterator[None]:
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
def _progress() -> Iterator[Any]:
    """Progress by parts of the study."""
    with Progress("reproduce apps", 0, "parts") as progress:

        def show(label: str, done: int, total: int) -> None:
            progress.what, progress.total = label, total
            progress.advance(done - progress.done)

        yield show
