"""Notebooks run from top to bottom, and are committed with their results."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

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
    assert "seconds" in notebook.cells[0].source, "the first cell names the running time"
    assert not any("def " in cell.source for cell in code_cells(notebook))
