"""An evaluation as a file to hand on: one picture, or one HTML page that needs no other file."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from ikgrad.errors import DataError
from ikgrad.evaluation import Evaluation, cells
from ikgrad.files.places import check_suffix, in_one_move
from ikgrad.plots.evaluation import evaluation_page, remarks, summary_cells
from ikgrad.plots.style import save_figure, to_png
from ikgrad.robot import Robot

SUFFIXES = (".png", ".html")
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
img { width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .25rem .6rem; border-bottom: 1px solid #ddd; white-space: nowrap; }
th { white-space: pre-line; vertical-align: bottom; border-bottom: 2px solid #888; }
th:first-child, td:first-child { text-align: left; }
div { overflow-x: auto; }
"""


def save_evaluation(
    evaluations: Sequence[Evaluation],
    robot: Robot,
    path: str | Path,
    *,
    title: str,
    subtitle: str = "",
    force: bool = False,
) -> Path:
    """Write the page about an inverter, in one move.

    Args:
        evaluations: of one inverter, at least one, see `ikgrad.evaluate`.
        robot: whose inverter it is.
        path: PNG (a picture with the summary) or HTML (the picture inside, and every table in full), by its suffix.
        title: of the page.
        subtitle: one line about what was evaluated and how, HTML only.
        force: overwrite an existing file.

    Returns:
        The path.

    Raises:
        DataError: another suffix, the file exists and ``force`` is off, or it cannot be written.
    """
    path = Path(path)
    check_suffix(path, SUFFIXES)
    if path.suffix.lower() == ".png":
        return save_figure(evaluation_page(evaluations, robot, title=title), path, dpi=120, force=force)
    text = evaluation_html(evaluations, robot, title=title, subtitle=subtitle)
    try:
        with in_one_move(path, force=force) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot write the report: {error.strerror or error}") from error
    return path


def evaluation_html(evaluations: Sequence[Evaluation], robot: Robot, *, title: str, subtitle: str = "") -> str:
    """The page as HTML; nothing in it comes from elsewhere.

    Args:
        evaluations: of one inverter.
        robot: whose inverter it is.
        title: of the page.
        subtitle: one line below.
    """
    summary = summary_cells(evaluations)
    parts = [f"<h1>{html.escape(title)}</h1>", f"<p>{html.escape(subtitle)}</p>"]
    parts += [_table(summary)] if summary else []
    parts += [f"<p>{html.escape(line)}</p>" for line in remarks(evaluations)]
    if any(found.answers is not None for found in evaluations):
        picture = base64.b64encode(to_png(evaluation_page(evaluations, robot, summary=False), dpi=120)).decode()
        alt = "Histograms of the errors, errors over the workspace, and the worst answers"
        parts.append(f'<img alt="{alt}" src="data:image/png;base64,{picture}">')
    for found in evaluations:
        parts += [f"<h2>{html.escape(found.title)}</h2>", _table(cells(found))]
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(parts) + "\n</body></html>\n"


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = rows
    lines = ["<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in body]
    return "<div><table>\n" + "\n".join(lines) + "\n</table></div>"


__all__ = ["SUFFIXES", "evaluation_html", "save_evaluation"]
