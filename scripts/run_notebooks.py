"""Execute all notebooks, save them with outputs, renew the gallery: python scripts/run_notebooks.py [NOTEBOOK ...].

The picture at the top of a notebook, docs/images/gallery/NAME.png, is the output of its cell with the tag ``cover``;
docs/images/gallery/NAME_small.png is the same for docs/gallery.md.
"""

from __future__ import annotations

import base64
import io
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FOLDER, GALLERY = ROOT / "notebooks", ROOT / "docs/images/gallery"
LIMIT = 1_000_000  # bytes: notebooks are committed with their figures
SMALL = (360, 270)  # pixels that a thumbnail fits into
WIDGET = "application/vnd.jupyter.widget-view+json"  # lives as long as its kernel


def execute(path: Path) -> nbformat.NotebookNode:
    """Run all cells in a fresh kernel, in the notebook's folder; machine and time of the run are not kept."""
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(path.parent)}}
    client = NotebookClient(notebook, timeout=900, kernel_name="python3", resources=resources, record_timing=False)
    client.execute()
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    for cell in notebook.cells:
        cell.metadata = {key: value for key, value in cell.metadata.items() if key == "tags"}
        if cell.cell_type == "code":
            cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
            for out in cell.outputs:
                out.get("data", {}).pop(WIDGET, None)  # a reader without a kernel sees the still picture
    return notebook


def cover(notebook: nbformat.NotebookNode) -> bytes:
    """The PNG that the cell with the tag ``cover`` shows."""
    (cell,) = (cell for cell in notebook.cells if "cover" in cell.metadata.get("tags", []))
    (png,) = (out["data"]["image/png"] for out in cell.outputs if "image/png" in out.get("data", {}))
    return base64.b64decode(png)


def thumbnail(png: bytes) -> bytes:
    """The picture in small, in 64 colours."""
    with Image.open(io.BytesIO(png)) as image:
        small = image.convert("RGB")
        small.thumbnail(SMALL, Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.quantize(64).save(buffer, "png", optimize=True)
    return buffer.getvalue()


def main() -> int:
    """Refresh the notebooks named on the command line, or all."""
    GALLERY.mkdir(parents=True, exist_ok=True)
    for path in [Path(name) for name in sys.argv[1:]] or sorted(FOLDER.glob("*.ipynb")):
        begin = time.perf_counter()
        notebook = execute(path)
        text = nbformat.writes(notebook) + "\n"
        if len(text.encode()) > LIMIT:
            print(f"{path.name}: {len(text):,} bytes are too many; draw smaller figures", file=sys.stderr)
            return 1
        path.write_text(text, encoding="utf-8")
        (GALLERY / f"{path.stem}.png").write_bytes(cover(notebook))
        (GALLERY / f"{path.stem}_small.png").write_bytes(thumbnail(cover(notebook)))
        print(f"{path.name}: {time.perf_counter() - begin:.0f} s, {len(text) / 1000:,.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
