"""Figures one after the other as a GIF."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.errors import DataError
from ikgrad.files.places import check_suffix, in_one_move

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = 64  # of the palette; flat shades need no more


def save_film(
    path: str | Path, figures: Iterable[Figure], *, frame_seconds: float, dpi: int = 80, force: bool = True
) -> Path:
    """Write a GIF that repeats forever, in one move.

    Args:
        path: ends in ``.gif``.
        figures: of equal size; drawn one by one as they come, so they may be one figure that changes.
        frame_seconds: how long each stands; GIFs count in hundredths.
        dpi: pixels per inch.
        force: overwrite an existing file.

    Returns:
        The path.

    Raises:
        DataError: another suffix, the file exists and ``force`` is off, or it cannot be written.

    Example:
        >>> import tempfile
        >>> from ikgrad.plots.style import new_figure
        >>> save_film(Path(tempfile.mkdtemp(), "a.gif"), [new_figure((1, 1))] * 2, frame_seconds=0.1).name
        'a.gif'
    """
    from PIL import Image

    path = Path(path)
    check_suffix(path, (".gif",))
    pictures = []
    for figure in figures:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=dpi)
        pictures.append(Image.open(buffer).convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS))
    settings = {"save_all": True, "append_images": pictures[1:], "duration": round(1000 * frame_seconds), "loop": 0}
    try:
        with in_one_move(path, force=force) as temporary:
            pictures[0].save(temporary, format="GIF", **settings)
    except OSError as error:
        raise DataError(f"{path}: cannot write the film: {error.strerror or error}") from error
    return path


__all__ = ["save_film"]
