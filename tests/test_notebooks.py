"""Notebooks run from top to bottom, and are committed with their results."""

from __future__ import annotations

import base64
import importlib.util
import io
import re
from pathlib import Path
from types import ModuleType

import nbformat
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("run_notebooks", ROOT / "scripts/run_notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def code_cells(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def pictures(notebook: nbformat.NotebookNode) -> int:
    return sum("image/png" in out.get("data", {}) for cell in code_cells(notebook) for out in cell.outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_what_is_committed(path: Path, script: ModuleType, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MINUTES", "0.02")  # of training, where a notebook leaves that open
    fresh, committed = script.execute(path), nbformat.read(path, as_version=4)
    assert pictures(fresh) == pictures(committed) > 0
    for new, old in zip(code_cells(fresh), code_cells(committed), strict=True):
        assert [out.output_type for out in new.outputs] == [out.output_type for out in old.outputs], new.source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_committed_with_results_and_small(path: Path):
    notebook = nbformat.read(path, as_version=4)
    assert path.stat().st_size < 1_000_000
    assert all(cell.outputs for cell in code_cells(notebook)), "run scripts/run_notebooks.py"
    assert re.search(r"^Running time: about \d+ seconds", notebook.cells[0].source, re.MULTILINE)
    assert not any("def " in cell.source for cell in code_cells(notebook))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_picture_at_the_top_is_what_the_notebook_makes(path: Path, script: ModuleType):
    notebook = nbformat.read(path, as_version=4)
    picture, small = (script.GALLERY / f"{path.stem}{end}.png" for end in ("", "_small"))
    assert f"](../docs/images/gallery/{picture.name})" in notebook.cells[0].source
    assert picture.read_bytes() == script.cover(notebook), "run scripts/run_notebooks.py"
    assert small.stat().st_size < 40_000
    with Image.open(picture) as large, Image.open(small) as thumb:
        assert max(thumb.width / 360, thumb.height / 270) == 1
        assert thumb.width / thumb.height == pytest.approx(large.width / large.height, rel=0.02)
    assert f"images/gallery/{small.name})](../notebooks/{path.name})" in (ROOT / "docs/gallery.md").read_text()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_there_is_something_to_try_and_a_still_picture_of_it(path: Path, script: ModuleType):
    cells = [cell for cell in code_cells(nbformat.read(path, as_version=4)) if "plots.explore(" in cell.source]
    assert cells
    for cell in cells:
        (out,) = cell.outputs
        assert set(out.data) == {"image/png", "text/plain"}, "no widget is kept: it is dead without its kernel"
        assert out.data["text/plain"].startswith("a figure at ")
        assert Image.open(io.BytesIO(base64.b64decode(out.data["image/png"]))).width > 300
