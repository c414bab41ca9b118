"""Help texts explain every option, and the doctor knows every extra."""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from ikgrad.cli import checkup
from ikgrad.cli.main import build_parser, main

ROOT = Path(__file__).parents[2]


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                yield from parsers(child)


@pytest.mark.parametrize("parser", list(parsers(build_parser())), ids=lambda parser: parser.prog)
def test_every_option_is_explained(parser: argparse.ArgumentParser):
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            assert action.help, action


def test_the_doctor_lists_every_extra(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    needs = [f"{need} ; extra == '{extra}'" for extra, wanted in extras.items() for need in wanted]
    monkeypatch.setattr(checkup.importlib.metadata, "requires", lambda name: needs)
    main(["doctor", "--json"])
    assert set(json.loads(capsys.readouterr().out)["extras"]) == set(extras) - {"dev"}
    main(["doctor"])
    printed = capsys.readouterr().out
    assert all(f"[{extra}] " in printed for extra in extras if extra != "dev")
