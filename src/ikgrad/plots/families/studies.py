"""Studies of ``ikgrad reproduce``: their own figures, drawn again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.errors import DataError
from ikgrad.files.peek import Peek
from ikgrad.plots.families.base import Draw, Family, Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT = {"apps": "convergence", "puma": "learning", "denso": "drift", "trajectory": "sweep"}
SUFFIX = "_study.npz"


def find(looks: Sequence[Peek]) -> Found | None:
    """The folder of a study, its JSON, or the file with its records."""
    stored = _stored(looks[0])
    if stored is None:
        return None
    paper = stored.name.removesuffix(SUFFIX)
    if not stored.is_file():
        raise DataError(f"{stored}: is missing and holds the curves; `ikgrad reproduce {paper} --out DIR` writes it")
    names = [name.removeprefix(f"{paper}_") for name in _figures(paper)]
    names.sort(key=lambda name: name != DEFAULT[paper])
    return {name: _drawer(stored, paper, name) for name in names}


def _stored(look: Peek) -> Path | None:
    if look.kind == "folder":
        found = sorted(path for path in look.path.glob(f"*{SUFFIX}") if path.name.removesuffix(SUFFIX) in DEFAULT)
        if len(found) > 1:
            raise DataError(f"{look.path}: holds several studies; name one of {', '.join(map(str, found))}")
        jsons = [path for path in look.path.glob("*.json") if path.stem in DEFAULT]
        return found[0] if found else jsons[0].with_name(jsons[0].stem + SUFFIX) if jsons else None
    if look.kind == ".json" and isinstance(look.document, dict):
        paper = look.document.get("paper")
        return look.path.with_name(f"{paper}{SUFFIX}") if paper in DEFAULT else None
    return look.path if look.kind == ".npz" and look.path.name.removesuffix(SUFFIX) in DEFAULT else None


def _figures(paper: str) -> Mapping[str, Draw]:
    found: Mapping[str, Draw] = import_module(f"ikgrad.papers.{paper}.figures").FIGURES
    return found


def _drawer(stored: Path, paper: str, name: str) -> Draw:
    def draw(_: object) -> Figure:
        from ikgrad.papers.store import load_study

        return _figures(paper)[f"{paper}_{name}"](load_study(stored))

    return draw


FAMILY = Family("a study of `ikgrad reproduce`", find)
