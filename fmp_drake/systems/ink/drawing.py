"""Initial ink of a board from words or a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, UnidentifiedImageError
from pydrake.math import RigidTransform

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, Mask, check_number
from fmp_drake.systems.ink.grid import InkGrid

QUARTER_TURNS = 1
"""Rotation of writing for a viewer opposite the robot at a table-top board: it runs
along y of B, with one line after another along x. See `upright_turns`."""

MARGIN = 0.05
"""Fraction of the board's edges that a drawing keeps free on either side."""

_LINE_STEP = 1.3  # line to line, in letter heights
_FINE = 4  # samples along the edge of a cell


def upright_turns(grid: InkGrid, *, X_WB: RigidTransform, eye: ArrayLike) -> int:
    """Return the rotation of writing along the longer edge that is upright for a viewer.

    Parameters
    ----------
    grid : InkGrid
        The board.
    X_WB : RigidTransform
        The board in the world, whose z axis points up.
    eye : array_like, shape (3,)
        Position of the viewer's eye in W, m.

    Returns
    -------
    int
        `quarter_turns` for `draw_words` and `draw_picture`.
    """
    view = X_WB.translation() - np.asarray(eye, dtype=float)
    view /= np.linalg.norm(view)
    up_W = np.array([0.0, 0.0, 1.0])
    up_B = X_WB.rotation().matrix().T @ (up_W - (up_W @ view) * view)
    if grid.size[0] >= grid.size[1]:
        return 0 if up_B[1] >= 0.0 else 2
    return 1 if up_B[0] <= 0.0 else 3


def draw_words(
    grid: InkGrid,
    text: str,
    *,
    height: float | None = None,
    quarter_turns: int = QUARTER_TURNS,
) -> Array:
    """Return the ink of words on a board.

    Parameters
    ----------
    grid : InkGrid
        The cells; 2.5 mm or less for letters below 10 cm.
    text : str
        The words; a line break begins a new line.
    height : float, optional
        Height of a capital letter in metres; by default as large as fits.
    quarter_turns : int
        Counterclockwise turns by 90 degrees, seen from outside: at 0 the writing
        runs along x of B with y upward.

    Returns
    -------
    ndarray, shape (ny, nx)
        Initial ink, from 0 to 1: the fraction of each cell that is written on.

    Raises
    ------
    SystemsError
        If there is nothing to write, the height is not positive, or the words
        leave no ink on the board.
    """
    if not text.strip():
        raise SystemsError("draw_words got no words: give text that can be seen.")
    outlines: list[Array] = []
    for i, line in enumerate(text.strip("\n").split("\n")):
        polygons = _outlines(line)
        if polygons:
            x = np.concatenate([p[:, 0] for p in polygons])
            start = np.array([0.5 * (x.min() + x.max()), i * _LINE_STEP])
            outlines += [p - start for p in polygons]
    points = np.concatenate(outlines)
    low, high = points.min(axis=0), points.max(axis=0)
    available, pitch, shape = _canvas(grid, quarter_turns)
    largest = float(np.min(available / (high - low)))
    height = _size(height, "the height of the words", largest)
    middle = 0.5 * (low + high)
    canvas = np.zeros(shape, dtype=bool)
    size = np.array(canvas.shape[::-1])
    for outline in outlines:
        # Letters may have holes: an outline within an outline has no ink.
        p = (outline - middle) * height * (_FINE / pitch)
        pixel = np.column_stack([p[:, 0] + 0.5 * size[0], 0.5 * size[1] - p[:, 1]])
        canvas ^= _filled(pixel - 0.5, canvas.shape)
    ink = _on_board(canvas.astype(float), grid, quarter_turns)
    if not ink.any():
        raise SystemsError(
            f"draw_words of {text!r} leaves no ink on the board: make it larger."
        )
    return ink


def draw_picture(
    grid: InkGrid,
    path: str | Path,
    *,
    size: float | None = None,
    quarter_turns: int = QUARTER_TURNS,
) -> Array:
    """Return the ink of a picture on a board: dark is ink, white and transparent is none.

    Parameters
    ----------
    grid : InkGrid
        The cells.
    path : str or Path
        File of the picture, in any format that Pillow reads, such as PNG or JPEG.
    size : float, optional
        Width of the picture in metres; by default as large as fits.
    quarter_turns : int
        As for `draw_words`.

    Returns
    -------
    ndarray, shape (ny, nx)
        Initial ink, from 0 to 1: the mean darkness over each cell.

    Raises
    ------
    SystemsError
        If there is no such file, it is not a picture or broken, the size is not
        positive, or the picture leaves no ink on the board.
    """
    picture = _read(Path(path))
    available, pitch, shape = _canvas(grid, quarter_turns)
    largest = float(min(available[0], available[1] * picture.width / picture.height))
    size = _size(size, "the width of the picture", largest)
    extent = np.array([size, size * picture.height / picture.width])
    pixels = np.maximum(np.rint(extent * _FINE / pitch), 1).astype(int)
    small = picture.resize((int(pixels[0]), int(pixels[1])), Image.Resampling.BOX)
    canvas = Image.new("F", shape[::-1], 0.0)
    corner = 0.5 * (np.array(shape[::-1]) - pixels)
    canvas.paste(small, (int(np.rint(corner[0])), int(np.rint(corner[1]))))
    ink = _on_board(np.array(canvas, dtype=float), grid, quarter_turns)
    if not ink.max(initial=0.0) > 1.0 / 255.0:
        raise SystemsError(
            f"the picture {Path(path).name} leaves no ink on the board: it is white; "
            "dark is ink."
        )
    return ink


def _size(given: float | None, what: str, largest: float) -> float:
    """Return a size in m, checked; without one, the largest that keeps the margins."""
    if given is None:
        return largest
    check_number(given, what, above=0, unit="m", error=SystemsError)
    if given > (most := largest / (1 - 2 * MARGIN)):
        raise SystemsError(
            f"{what} is {given:g} m, larger than the board; it has room for {most:.3g} m."
        )
    return given


def _outlines(line: str) -> list[Array]:
    """Return the outlines of a line of text, in heights of a capital letter."""
    # Slow to import, for words only.
    from matplotlib.font_manager import FontProperties, findfont, get_font
    from matplotlib.textpath import TextPath

    if not line.strip():
        return []
    prop = FontProperties(family="DejaVu Sans", weight="bold")
    face = get_font(findfont(prop))
    missing = [
        c for c in line if not c.isprintable() or not face.get_char_index(ord(c))
    ]
    if missing:
        raise SystemsError(
            f"draw_words cannot write {missing[0]!r}: {face.family_name} has no such "
            "letter."
        )
    capital = TextPath((0, 0), "H", size=100.0, prop=prop).get_extents().height
    # Escape dollar signs, which otherwise begin a formula.
    path = TextPath((0, 0), line.replace("$", r"\$"), size=100.0, prop=prop)
    return [np.asarray(p) / float(capital) for p in path.to_polygons()]


def _read(path: Path) -> Image.Image:
    """Return a picture's darkness from 0 to 1, mode F."""
    try:
        with Image.open(path) as picture:
            rgba = picture.convert("RGBA")
    except FileNotFoundError:
        raise SystemsError(f"there is no picture {path}.") from None
    except UnidentifiedImageError:
        raise SystemsError(
            f"{path} is not a picture that Pillow reads: give a PNG or JPEG."
        ) from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise SystemsError(f"the picture {path} cannot be read: {error}.") from None
    values = np.asarray(rgba, dtype=np.float32) / 255.0
    grey = values[..., :3] @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    return Image.fromarray((1.0 - grey) * values[..., 3])


def _canvas(grid: InkGrid, quarter_turns: int) -> tuple[Array, Array, tuple[int, int]]:
    """Return the sizes of an upright canvas; odd quarter turns swap the board's edges.

    They are the greatest width and height of a drawing, m; the width and height of a
    cell, m; and the numbers of rows and columns of samples.
    """
    step = -1 if quarter_turns % 2 else 1
    ny, nx = grid.shape[::step]
    available = np.array(grid.size[::step]) * (1.0 - 2.0 * MARGIN)
    return available, grid.pitch[::step], (ny * _FINE, nx * _FINE)


def _filled(pixel: Array, shape: tuple[int, int]) -> Mask:
    image = Image.new("1", shape[::-1])
    if len(pixel) > 2:
        ImageDraw.Draw(image).polygon([tuple(p) for p in pixel], fill=1)
    return np.array(image, dtype=bool)


def _on_board(canvas: Array, grid: InkGrid, quarter_turns: int) -> Array:
    """Average a canvas (first row at the top) over the cells of a board."""
    rotated = np.rot90(canvas, quarter_turns)[::-1]
    ny, nx = grid.shape
    cells: Array = rotated.reshape(ny, _FINE, nx, _FINE).mean(axis=(1, 3))
    return np.clip(cells, 0.0, 1.0)
