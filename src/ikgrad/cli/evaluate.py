"""``ikgrad evaluate``: an inverter by the protocols that others use, as tables, JSON and a page with pictures."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.cli.inverters import add_inverter_options, load
from ikgrad.cli.parsing import Commands, count, example, seed
from ikgrad.cli.terminal import Progress, finite, note, print_json, print_table

if TYPE_CHECKING:
    from ikgrad.evaluation import Evaluation
    from ikgrad.networks import BestOfStarts
    from ikgrad.networks.storage import AnyInverter

NAMES = ("local", "global", "ikflow", "tracik", "path", "line")  # those of ikgrad.evaluation.PROTOCOLS
FILES = ("evaluation.json", "evaluation.png", "evaluation.html")
DESCRIPTION = """\
measure an inverter by protocols that are named after their source:

local    target within 0.5 rad a joint of the present joints
global   target and present joints anywhere in the limits
ikflow   500 poses x 50 random present joints, means (IKFlow, 2022)
tracik   solve_ik to 1e-5 m and rad from the inverter and from other starts (TRAC-IK, 2015)
path     smooth joint-space paths in closed loop: errors, reconfigurations, largest jump (after IKLink, 2024)
line     straight lines in task space, likewise

The inverter stands alone, then with 1, 2 and 3 damped solver steps after it, then plain damped steps without it. All
errors are measured by forward kinematics that the inverter had no part in. Percentiles are median / 95th / 99.9th."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "evaluate",
        help="measure a trained inverter by named protocols",
        description=DESCRIPTION,
        epilog=example(
            "ikgrad evaluate runs/panda\n"
            "ikgrad evaluate runs/panda --protocols local,path --count 5000 --report panda.html\n"
            "ikgrad evaluate my-inverter --robot arm.urdf --tip tool0 --out report --json"
        ),
    )
    add_inverter_options(parser)
    parser.add_argument(
        "--protocols", type=protocols, default=NAMES, metavar="NAMES", help="with commas between (default: all)"
    )
    parser.add_argument("--count", type=count, metavar="N", help="poses a protocol (10,000; 500 x 50 for ikflow)")
    parser.add_argument(
        "--starts",
        type=count,
        metavar="K",
        help="the best of K answers from scattered joints, not from the present ones",
    )
    parser.add_argument("--seed", type=seed, default=0, help="of the poses (default 0)")
    parser.add_argument("--threads", type=count, default=1, metavar="N", help="of torch and of the solver (1)")
    parser.add_argument("--report", metavar="FILE", help="write the page with pictures, .png or .html")
    parser.add_argument("--out", metavar="DIR", help=f"folder for {', '.join(FILES)}; made if it is missing")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    parser.set_defaults(run=run)


def protocols(text: str) -> tuple[str, ...]:
    """Names of protocols with commas between."""
    from ikgrad.errors import UnknownNameError

    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for name in names:
        if name not in NAMES:
            raise argparse.ArgumentTypeError(str(UnknownNameError("protocol", name, NAMES)))
    if not names:
        raise argparse.ArgumentTypeError(f"expected some of {','.join(NAMES)}, got '{text}'")
    return names


def run(args: argparse.Namespace) -> int:
    """Check all places, load, measure, print, write."""
    from ikgrad.cli.reproduce.shared import output_folder

    with output_folder(args.out):
        places = _places(args)
        inverter = _from_starts(load(args), args.starts)
        found, left_out = _evaluate(args, inverter)
        document = _document(args, inverter, found, left_out)
        if args.json:
            print_json(document)
        else:
            _print(found, left_out)
        _write(places, inverter, found, document, force=args.force)
    return 0


def _from_starts(inverter: AnyInverter, starts: int | None) -> AnyInverter | BestOfStarts:
    """The inverter itself, or the best of its answers."""
    from ikgrad.errors import ConfigError
    from ikgrad.networks import BestOfStarts, IncrementInverter

    if starts is None:
        return inverter
    if not isinstance(inverter, IncrementInverter):
        raise ConfigError(f"--starts is for the families increment and unrolled, not for {family(inverter)}")
    return BestOfStarts(inverter, starts=starts)


def _places(args: argparse.Namespace) -> list[Path]:
    """The files to be; refused before any work is done."""
    from ikgrad.files.places import check_output
    from ikgrad.plots.page import SUFFIXES

    places = [check_output(args.report, SUFFIXES, force=args.force)] if args.report else []
    if args.out:
        places += [check_output(Path(args.out) / name, (*SUFFIXES, ".json"), force=args.force) for name in FILES]
    return places


def _evaluate(
    args: argparse.Namespace, inverter: AnyInverter | BestOfStarts
) -> tuple[list[Evaluation], dict[str, str]]:
    """What was measured, and why something was not."""
    import torch

    from ikgrad.errors import RobotError
    from ikgrad.evaluation import PROTOCOLS, evaluate

    before = torch.get_num_threads()
    found, left_out = [], {}
    try:
        torch.set_num_threads(args.threads)
        with Progress("evaluate", len(args.protocols), "protocols") as progress:
            for name in args.protocols:
                try:
                    found.append(evaluate(inverter, PROTOCOLS[name](count=args.count or 0, seed=args.seed)))
                except RobotError as error:
                    if len(args.protocols) == 1:
                        raise
                    left_out[name] = str(error)
                progress.advance(1)
    finally:
        torch.set_num_threads(before)
    if not found:
        raise RobotError("; ".join(f"{name}: {why}" for name, why in left_out.items()))
    return found, left_out


def _document(
    args: argparse.Namespace, inverter: AnyInverter | BestOfStarts, found: list[Evaluation], left_out: dict[str, str]
) -> dict[str, Any]:
    import platform

    import torch

    from ikgrad import __version__

    return {
        "inverter": str(args.run_folder),
        "robot": inverter.robot.name,
        "fingerprint": inverter.robot.fingerprint,
        "family": family(inverter),
        "parameters": sum(p.numel() for p in inverter.parameters()),
        "evaluations": [evaluation.record() for evaluation in found],
        "left_out": left_out,
        "versions": {"ikgrad": __version__, "torch": torch.__version__, "python": platform.python_version()},
    }


def family(inverter: AnyInverter | BestOfStarts) -> str:
    """What kind of inverter it is, in words."""
    from ikgrad.networks import BestOfStarts, Inverter

    if isinstance(inverter, BestOfStarts):
        return f"best of {len(inverter.q_starts)} {inverter.inverter.family}"

    if isinstance(inverter, Inverter):
        return "classic, present joints as inputs" if inverter.feedback else "classic, traditional"
    return inverter.family


def _print(found: list[Evaluation], left_out: dict[str, str]) -> None:
    from ikgrad.evaluation import cells

    for evaluation in found:
        head, *rows = cells(evaluation)
        print_table(f"ikgrad evaluate: {evaluation.title}", head, rows, right=range(1, len(head)))
        for text in evaluation.notes:
            print(text)
        print()
    for name, why in left_out.items():
        print(f"{name}: left out, {why}")


def _write(
    places: list[Path],
    inverter: AnyInverter | BestOfStarts,
    found: list[Evaluation],
    document: dict[str, Any],
    *,
    force: bool,
) -> None:
    from ikgrad.files.places import in_one_move
    from ikgrad.plots.page import save_evaluation

    title = f"{inverter.robot.name}: {document['family']} inverter"
    versions = ", ".join(f"{name} {version}" for name, version in document["versions"].items())
    subtitle = f"{document['inverter']}, {document['parameters']:,} parameters, seed {found[0].seed}; {versions}"
    for path in places:
        if path.suffix == ".json":
            with in_one_move(path, force=force) as temporary:
                temporary.write_text(json.dumps(finite(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        else:
            save_evaluation(found, inverter.robot, path, title=title, subtitle=subtitle, force=force)
    if places:
        note(f"wrote {', '.join(map(str, places))}")
