"""Entry of the command ``ikgrad``: build the parser, run a command, turn errors into one line and an exit status.

Exit status: 0 done; 1 `ikgrad doctor` found something broken; 2 a mistake that one line on stderr explains; 130 Ctrl-C;
141 nobody reads the output any more.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ikgrad import __version__
from ikgrad.cli import (
    bench,
    completion,
    doctor,
    evaluate,
    export,
    fk,
    map,
    merge,
    plot,
    reproduce,
    robots,
    sample,
    solve,
    train,
    view,
)
from ikgrad.cli.parsing import Parser, example
from ikgrad.cli.terminal import Interrupted, note
from ikgrad.errors import IkgradError, describe

COMMANDS = (
    robots,
    fk,
    sample,
    solve,
    merge,
    map,
    train,
    evaluate,
    export,
    reproduce,
    bench,
    plot,
    view,
    doctor,
    completion,
)  # each has add(commands), which sets run(args)


class _Version(argparse._VersionAction):
    """Print versions; that of torch is read from its metadata, since importing it takes a second."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print and exit."""
        try:
            torch = f"torch {version('torch')}"
        except PackageNotFoundError:
            torch = "no torch"
        print(f"ikgrad {__version__} ({torch}, Python {platform.python_version()})")
        parser.exit()


def build_parser() -> Parser:
    """The parser of all commands; cheap, nothing heavy is imported."""
    parser = Parser(
        prog="ikgrad",
        description="Forward and inverse kinematics for any URDF, for whole files of poses.",
        epilog=example(
            "ikgrad sample --robot panda --count 1000 --seed 0 -o poses.csv\n"
            "ikgrad solve --robot panda poses.csv -o joints.csv"
        ),
    )
    parser.add_argument("--version", action=_Version, help="show the versions of ikgrad and torch, and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, title="commands")
    for command in COMMANDS:
        command.add(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line.

    Args:
        argv: the arguments; default: those of the process.

    Returns:
        The exit status, see the module docstring.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # waiting threads of torch must not starve the other kernels
    try:
        args = build_parser().parse_args(argv)
        status: int = args.run(args)
        sys.stdout.flush()
        return status
    except SystemExit as stop:  # argparse: help was printed, or a mistake was explained
        return stop.code if isinstance(stop.code, int) else 2
    except Interrupted as stop:
        note(str(stop))
        return 130
    except KeyboardInterrupt:
        note("interrupted; nothing was written")
        return 130
    except BrokenPipeError:
        _silence_stdout()
        return 141
    except IkgradError as error:
        note(str(error))
    except OSError as error:
        _silence_stdout()
        note(describe(error))
    except MemoryError:
        note("out of memory; give fewer rows at a time")
    return 2


def _silence_stdout() -> None:
    """What is still buffered must not fail once more when the interpreter closes stdout."""
    with contextlib.suppress(OSError, ValueError):  # no real file behind it
        try:
            sys.stdout.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
