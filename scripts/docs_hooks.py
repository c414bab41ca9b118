"""What mkdocs does besides: the notebooks, which lie outside docs/, become pages of the site, with the files beside."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PICTURES = {"image/png": "png", "image/gif": "gif"}


def on_files(files: Files, config: Any) -> Files:
    """Add a page for every notebook, its pictures, and the notebook itself."""
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        name = f"notebooks/{path.stem}"
        text, pictures = page(path)
        files.append(File.generated(config, f"{name}.md", content=text))
        files.append(File.generated(config, f"{name}.ipynb", abs_src_path=str(path)))
        for file, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{file}", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links that leave docs/ for a notebook lead to its page, one folder earlier on the site."""
    up = "../" * page.file.src_uri.count("/")
    return re.sub(r"\]\((?:\.\./)+notebooks/(\w+)\.ipynb", rf"]({up}notebooks/\1.md", markdown)


def page(path: Path) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by file name."""
    pictures: dict[str, bytes] = {}
    parts = []
    for k, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source.replace("](../docs/", "](../"))
            continue
        parts.append(f"```python\n{source}\n```")
        parts += [shown(output, f"{path.stem}_{k}", pictures) for output in cell["outputs"]]
    title, rest = parts[0].split("\n", 1)
    parts[0] = f"{title}\n\n[The notebook itself]({path.name}), to download and run.\n{rest}"
    return "\n\n".join(parts), pictures


def shown(output: dict[str, Any], name: str, pictures: dict[str, bytes]) -> str:
    """One output of a cell: a picture, a table, or text."""
    data = {kind: "".join(text) for kind, text in output.get("data", {}).items()}
    for kind, suffix in PICTURES.items():
        if kind in data:
            pictures[f"{name}.{suffix}"] = base64.b64decode(data[kind])
            return f"![{data.get('text/plain', '')}]({name}.{suffix})".replace("<", "").replace(">", "")
    for kind in ("text/html", "text/markdown"):
        if kind in data:
            return data[kind]
    text = data.get("text/plain") or "".join(output.get("text", ""))
    return f"```text\n{text.rstrip()}\n```"
