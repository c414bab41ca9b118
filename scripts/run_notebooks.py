"""Execute every notebook and save it with its outputs: python scripts/run_notebooks.py [NOTEBOOK ...]."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
LIMIT = 1_000_000  # bytes: notebooks are committed with their figures


def execute(path: Path) -> nbformat.NotebookNode:
    """Run all cells in a fresh kernel, in the notebook's folder; machine and time of the run are not kept."""
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(path.parent)}}
    client = NotebookClient(notebook, timeout=900, kernel_name="python3", resources=resources, record_timing=False)
    client.execute()
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
    return notebook


def main() -> int:
    """Refresh the notebooks named on the command line, or all."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(FOLDER.glob("*.ipynb")):
        begin = time.perf_counter()
        text = nbformat.writes(execute(path)) + "\n"
        if len(text.encode()) > LIMIT:
            print(f"{path.name}: {len(text):,} bytes are too many; draw smaller figures", file=sys.stderr)
            return 1
        path.write_text(text, encoding="utf-8")
        print(f"{path.name}: {time.perf_counter() - begin:.0f} s, {len(text) / 1000:,.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
