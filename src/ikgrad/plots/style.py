"""What all figures share: colours, fonts, an empty figure, and how one is written."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ikgrad.errors import DataError
from ikgrad.files.places import check_suffix, in_one_move

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#333333")
INK, FAINT = "#333333", "#999999"
SUFFIXES = (".png", ".svg")
ERROR_LABEL = "E [m$^2$ + 1]"  # squares of three coordinates and of nine rotation entries, which have no unit

STYLE: Any = {
    "font.size": 11.0,
    "axes.titlesize": 12.0,
    "axes.labelsize": 11.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.8,
    "lines.linewidth": 2.0,
    "legend.frameon": False,
    "legend.fontsize": 10.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "ikgrad",
}


def styled() -> Any:
    """Our settings inside a ``with`` block; matplotlib's own are back afterwards."""
    import matplotlib

    return matplotlib.rc_context(STYLE)


def new_figure(size: tuple[float, float]) -> Figure:
    """An empty figure of so many inches, which no display and no pyplot knows of."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path, *, dpi: int = 150, force: bool = True) -> Path:
    """Write a figure in one move: readers see the old file or the new one, never half of it.

    Args:
        figure: the figure.
        path: PNG or SVG, by its suffix.
        dpi: pixels per inch of a PNG.
        force: overwrite an existing file.

    Returns:
        The path.

    Raises:
        DataError: another suffix, the file exists and ``force`` is off, or it cannot be written.
    """
    path = Path(path)
    check_suffix(path, SUFFIXES)
    date = {"Date": None} if path.suffix == ".svg" else {}  # the same figure is the same file
    try:
        with styled(), in_one_move(path, force=force) as temporary:
            figure.savefig(temporary, dpi=dpi, metadata=date)
    except OSError as error:
        raise DataError(f"{path}: cannot write the figure: {error.strerror or error}") from error
    return path


def to_png(figure: Figure, *, dpi: int = 90) -> bytes:
    """A figure as the bytes of a PNG, for notebooks: ``IPython.display.Image(to_png(figure))``."""
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def calm_log(axis: Any) -> None:
    """Fewer labels between the powers of ten of a logarithmic axis, else they overlap."""
    from matplotlib.ticker import LogFormatterSciNotation

    axis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(1.0, 0.2)))


def power(value: float) -> str:
    """1e-09 as 1e-9."""
    return f"{value:g}".replace("e-0", "e-")
