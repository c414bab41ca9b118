"""Reference pictures: small, compared so that fonts may be drawn a little differently but nothing may be missing.

A picture is averaged over blocks of 4 x 4 pixels, and a block may lie anywhere between its neighbours in the other
picture; that forgives hinting, antialiasing and shifts by a block. The difference is the root mean square of what is
left, over the blocks where either picture has ink, in grey levels of 255. `TOLERANCE` stands between two measurements:
matplotlib 3.9.4 and 3.10.0 with FreeType 2.6.1 draw what 3.11.2 with 2.14.3 drew within 5.2 in every case; a curve that
is missing, another colour, an axis that is 10 % longer and labels that are missing give 11 to 40 in line charts. Thin
lines of three-dimensional pictures weigh less: there, only changes of the arm or of the view are sure to be seen.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from figure_cases import FIGURES
from PIL import Image

from ikgrad import plots

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests" / "images"
LEFT = ROOT / "out" / "images"  # where a failure leaves its pictures
CASES = (
    "solve_summary",
    "workspace_errors",
    "arm_frames",
    "arm_path",
    "arm_motion_chart",
    "convergence",
    "curve_panels",
    "drift",
    "method_errors",
    "pose_places",
    "solver_times",
    "swept_arm",
)
DPI = 64
TOLERANCE = 7.0
BLOCK = 4


def path_of(name: str) -> Path:
    """Where the reference of a case lies."""
    return FOLDER / f"{name}.png"


def draw(name: str) -> np.ndarray:
    """The picture of a case as it is now, (h, w, 3)."""
    with matplotlib.rc_context({"text.hinting": "none"}):
        return read(io.BytesIO(plots.to_png(FIGURES[name](), dpi=DPI)))


def read(file: Path | io.BytesIO) -> np.ndarray:
    with Image.open(file) as image:
        return np.asarray(image.convert("RGB"))


def write(picture: np.ndarray, path: Path) -> None:
    """As few bytes as possible: a palette is enough."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(picture).convert("P", palette=Image.Palette.ADAPTIVE, colors=64)
    image.save(path, optimize=True)


def blocks(picture: np.ndarray) -> np.ndarray:
    """Means over blocks of pixels, (rows, columns, 3)."""
    h, w = (BLOCK * (size // BLOCK) for size in picture.shape[:2])
    cut = picture[:h, :w].astype(float)
    return cut.reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK, 3).mean(axis=(1, 3))


def missing(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far each block lies outside what the nine blocks around that place in the other picture span."""
    padded = np.pad(other, ((1, 1), (1, 1), (0, 0)), mode="edge")
    h, w = other.shape[:2]
    around = np.stack([padded[i : i + h, j : j + w] for i in range(3) for j in range(3)])
    return np.maximum(0, np.maximum(one - around.max(axis=0), around.min(axis=0) - one))


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """How far two pictures are apart; infinite for other sizes."""
    if one.shape != other.shape:
        return float("inf")
    a, b = blocks(one), blocks(other)
    ink = (np.minimum(a, b) < 247).any(axis=-1)
    apart = np.maximum(missing(a, b), missing(b, a))[ink]
    return float(np.sqrt((apart**2).mean())) if ink.any() else 0.0


def check(name: str, now: np.ndarray, reference: np.ndarray) -> None:
    """Refuse a picture that has changed, and leave both and the difference where the message says."""
    found = difference(now, reference)
    if found <= TOLERANCE:
        return
    write(now, LEFT / f"{name}.png")
    write(reference, LEFT / f"{name}-reference.png")
    if now.shape == reference.shape:
        write(255 - np.abs(now.astype(int) - reference).astype(np.uint8), LEFT / f"{name}-difference.png")
    raise AssertionError(
        f"{name}: differs by {found:.1f} from tests/images/{name}.png, at most {TOLERANCE:g} is allowed; see {LEFT}. "
        "If the change is meant: python scripts/refresh_images.py"
    )
