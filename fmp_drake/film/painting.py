"""Ink, the path of the eraser, and a caption, painted into a rendered picture.

The renderer has no representation of ink. A pixel shows the face of the board where the
point that is seen lies on it. There the ink is looked up and multiplied with the pixel's
colour, so that light and shadows stay.
"""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import map_coordinates

from fmp_drake.film.scene import Shot
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.mesh import ink_colours
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.surface.surface import project_all

# Colours of ink on a white board by the fraction that is left, in 255ths.
_SHADES = ink_colours(np.linspace(0, 1, 256), srgb=True).astype(np.float32)
# Distance of a pixel's point from the board, m; the mesh of a curved one deviates by half.
_TOLERANCE = 4e-4

_TRAIL_COLOR = 255 * np.array([TRAIL_COLOR.r(), TRAIL_COLOR.g(), TRAIL_COLOR.b()])
_TRAIL_SEGMENTS = 12
_MOST_ALPHA = 0.85
_CAPTION_COLOR = "#1D2733"


def paint_ink(shot: Shot, grid: InkGrid, ink: ArrayLike) -> NDArray[np.bool_]:
    """Paint ink into a shot's colours, in place.

    Parameters
    ----------
    shot : Shot
    grid : InkGrid
    ink : array_like of uint8, shape (ny nx,)
        Ink that is left in each cell, 0 for none to 255 for all.

    Returns
    -------
    ndarray of bool, shape (height, width)
        Pixels that show the face of the board.
    """
    visible = np.isfinite(shot.depth)
    uvh = project_all(grid.curvature, shot.points(), np.zeros(2))
    at = (uvh[:, :2] - grid.corner) / grid.pitch
    is_face = np.all((at >= 0) & (at <= grid.shape[::-1]), axis=1)
    is_face &= np.abs(uvh[:, 2]) < _TOLERANCE
    visible[visible] = is_face
    # Between the centres of cells, and constant beyond the outermost.
    left = map_coordinates(
        np.reshape(ink, grid.shape).astype(np.float32),
        at[is_face, ::-1].T - 0.5,
        order=1,
        mode="nearest",
    )
    shades = _SHADES[np.rint(left).astype(np.uint8)]
    shot.color[visible] = np.rint(shot.color[visible] * shades).astype(np.uint8)
    return visible


def paint_trail(
    color: NDArray[np.uint8],
    pixels: NDArray[np.float64],
    *,
    where: NDArray[np.bool_],
) -> None:
    """Draw a line into a picture, in place, fading towards its start.

    Parameters
    ----------
    color : ndarray of uint8, shape (height, width, 3)
    pixels : ndarray, shape (k, 2)
        Columns and rows of its points.
    where : ndarray of bool, shape (height, width)
        The pixels that may be painted.
    """
    height, width = where.shape
    mask = Image.new("L", (width, height))
    draw = ImageDraw.Draw(mask)
    thickness = max(1, round(height / 220))
    segments = np.array_split(np.arange(len(pixels)), _TRAIL_SEGMENTS)
    for number, segment in enumerate(segments, start=1):
        if len(segment):
            points = pixels[segment[0] : segment[-1] + 2]
            shade = round(255 * _MOST_ALPHA * number / _TRAIL_SEGMENTS)
            draw.line([*map(tuple, points)], fill=shade, width=thickness, joint="curve")
    alpha = np.asarray(mask)[where, np.newaxis] / 255
    color[where] = np.rint((1 - alpha) * color[where] + alpha * _TRAIL_COLOR)


def draw_caption(picture: Image.Image, text: str) -> None:
    """Draw lines of text into a picture, at its lower left."""
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    size, margin = max(8, picture.height // 30), max(4, picture.height // 40)
    font = ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size)
    draw = ImageDraw.Draw(picture)
    at = (margin, picture.height - margin)
    draw.text(at, text, anchor="ld", font=font, fill=_CAPTION_COLOR)
