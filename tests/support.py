"""Robots and helpers that many tests share."""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

BUILTIN = ("arm4", "denso_vp6242", "iiwa14", "kr210", "panda", "puma560", "ur5e")

# A tree with a branch, fixed links, a slide, a skew axis that is no unit vector, a continuous joint that is followed
# by two mimic joints (one of them through the other), and a mimic joint whose master is on another branch.
ZOO = """<?xml version="1.0"?>
<robot name="zoo">
  <link name="world"/><link name="base"/><link name="a"/><link name="b"/><link name="b2"/><link name="c"/>
  <link name="d"/><link name="e"/><link name="hand"/><link name="finger"/>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.2 0.9"/></joint>
  <joint name="turn" type="continuous"><parent link="base"/><child link="a"/><origin xyz="0 0 0.4" rpy="0.1 0 0"/><axis xyz="1 2 2"/></joint>
  <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.2 0 0" rpy="0 0.5 0"/><axis xyz="0 -0.6 0.8"/><limit lower="-0.1" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="plate" type="fixed"><parent link="b"/><child link="b2"/><origin xyz="0 0.05 0" rpy="0 0 0.7"/></joint>
  <joint name="follow" type="revolute"><parent link="b2"/><child link="c"/><origin xyz="0 0 0.3"/><mimic joint="turn" multiplier="-0.5" offset="0.25"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="again" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0 0.2 0.1" rpy="-1 0 0"/><axis xyz="0 1 0"/><mimic joint="follow" multiplier="2"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="revolute"><parent link="d"/><child link="e"/><origin xyz="0 0 0.2"/><axis xyz="0 0 -1"/><limit lower="-2" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="grip" type="fixed"><parent link="e"/><child link="hand"/><origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/></joint>
  <joint name="finger_joint" type="prismatic"><parent link="b2"/><child link="finger"/><origin xyz="0 0.1 0"/><axis xyz="0 1 0"/><mimic joint="wrist" multiplier="0.01" offset="0.02"/><limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
</robot>
"""  # noqa: E501


def without_times(values: object) -> object:
    """A study as JSON, but for what differs from run to run."""
    if isinstance(values, dict):
        return {key: without_times(value) for key, value in values.items() if key != "seconds"}
    return [without_times(value) for value in values] if isinstance(values, list) else values


def mistake(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """The one line that a mistake on the command line prints."""
    from ikgrad.cli.main import main

    assert main(list(argv)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def block(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    """As if it were not installed, whatever was imported before."""
    for name in [package, *(name for name in sys.modules if name.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)


def weights_of(folder: Path) -> dict[str, bytes]:
    """All weights of a run, by file."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.safetensors"))}


class Killed(BaseException):
    """Nobody catches it."""


def cut_off_at_every_write(
    train: Callable[[Path], object], parent: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """Folders of a training that was killed as it moved its first, second, ... file into place, until none is left."""
    replace = os.replace
    for n in itertools.count(1):
        left, folder = n, parent / f"cut-{n}"

        def kill(*arguments: Any) -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            replace(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", kill)
            try:
                train(folder)
                return
            except Killed:
                pass
        yield folder
