"""argparse with one-line errors that name the nearest match, and the kinds of values that options take."""

from __future__ import annotations

import argparse
import difflib
import math
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

Commands = Any  # argparse's type of sub-command collections has no public name


class Parser(argparse.ArgumentParser):
    """A parser whose mistakes are one line on stderr and exit status 2."""

    def __init__(self, **settings: Any):
        settings.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        settings.setdefault("allow_abbrev", False)
        super().__init__(**settings)
        self._given: list[str] = []

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Remember what was given, and let values begin with a minus sign: ``--q -0.1,0.2``."""
        self._given = _joined(list(sys.argv[1:] if args is None else args))
        found, rest = super().parse_known_args(self._given, namespace)
        self._refuse_unknown_options(rest)
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line; a misspelt option explains more than what is missing without it."""
        self._refuse_unknown_options(self._given)
        self._fail(message)

    def _refuse_unknown_options(self, tokens: Sequence[str]) -> None:
        known = list(self._option_string_actions)
        for token in tokens:
            name = token.split("=", 1)[0]
            if name == "--":
                return
            if self._subparsers is not None and not name.startswith("-"):
                return  # the rest is for the sub-command to judge
            if re.match(r"--?[a-zA-Z]", name) and name not in known and name[:2] not in known:
                close = difflib.get_close_matches(name, known, n=1)
                self._fail(f"unknown option '{name}'" + (f"; did you mean '{close[0]}'?" if close else ""))

    def _fail(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Unknown commands and choices: the nearest match and what exists."""
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            close = difflib.get_close_matches(str(value), known, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise argparse.ArgumentError(action, f"unknown '{value}'{hint} (known: {', '.join(known)})")


def _joined(args: list[str]) -> list[str]:
    """``--q -0.1,0.2`` as ``--q=-0.1,0.2``: argparse takes a list that begins with a minus sign for an option."""
    joined: list[str] = []
    for arg in args:
        if re.match(r"-\.?\d", arg) and joined and re.fullmatch(r"--[a-z][a-z0-9-]*", joined[-1]):
            joined[-1] += "=" + arg
        else:
            joined.append(arg)
    return joined


def example(text: str) -> str:
    """The epilog of a command's help."""
    return "example:\n" + "\n".join("  " + line for line in text.strip().splitlines())


def add_robot_options(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """``--robot``, ``--base`` and ``--tip``."""
    text = "built-in name (`ikgrad robots` lists them) or path of a URDF file"
    parser.add_argument("--robot", required=required, metavar="ROBOT", help=text)
    parser.add_argument("--base", metavar="LINK", help="link in which poses are given (default: the root link)")
    parser.add_argument("--tip", metavar="LINK", help="link whose pose is meant (default: the only leaf link)")


def numbers(text: str) -> tuple[float, ...]:
    """Numbers with commas (or spaces) between."""
    try:
        values = tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        values = ()
    if not values or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"expected numbers with commas between, got '{text}'")
    return values


def mask(text: str) -> tuple[float, ...]:
    """Six zeros or ones."""
    parts = text.replace(",", " ").split()
    if len(parts) != 6 or not set(parts) <= {"0", "1"} or "1" not in parts:
        raise argparse.ArgumentTypeError(f"expected six zeros or ones like 1,1,1,0,0,0 and not all zero, got '{text}'")
    return tuple(float(part) for part in parts)


def positive(text: str) -> float:
    """A finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got '{text}'")
    return value


def count(text: str) -> int:
    """A whole number above zero; 1e6 and 1_000_000 are welcome."""
    return _whole(text, 1)


def seed(text: str) -> int:
    """A whole number from 0 to 2^63 - 1."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    try:
        value = int(float(text)) if re.fullmatch(r"\d+(\.0*)?[eE]\+?\d", text) else int(text)
    except ValueError:
        value = least - 1
    if not least <= value < 2**63:
        raise argparse.ArgumentTypeError(f"expected a whole number, at least {least}, got '{text}'")
    return value
