"""Overlays of a frame: the trail of the eraser, gauges and a caption."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
from pydrake.math import RigidTransform

from fmp_drake.errors import RunError
from fmp_drake.numeric import check_number
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR

# Colours of the page: of the eraser's path, and of its panel.
_TRAIL_COLOR = tuple(
    255 * c for c in (TRAIL_COLOR.r(), TRAIL_COLOR.g(), TRAIL_COLOR.b())
)
_TRAIL_SEGMENTS = 12
_MOST_ALPHA = 0.85
_CAPTION_COLOR = (29, 39, 51)
_TEXT, _EMPTY, _FULL, _BAND = "#1D2733", "#D5DAE1", "#3B7DD8", "#A9DCBB"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trail:
    """The measured path, drawn on the board behind the eraser, fading.

    Attributes
    ----------
    times : array_like, shape (M,)
        Ascending, s.
    positions : array_like, shape (M, 3)
        p_BE, m; the trail is drawn at their projection onto the board, if there is one.
    seconds : float
        Length of the trail.

    Examples
    --------
    >>> trail = Trail(times=[0.0, 1.0, 2.0], positions=np.eye(3), seconds=1.0)
    >>> trail.points(2.0).shape
    (50, 3)
    """

    times: ArrayLike
    positions: ArrayLike
    seconds: float = 4.0

    def check(self) -> None:
        """Raise a RunError where times and positions do not fit together."""
        times, path = np.asarray(self.times), np.asarray(self.positions)
        if times.ndim != 1 or path.shape != (len(times), 3) or len(times) < 2:
            raise RunError(
                f"a trail has times {times.shape} and positions {path.shape}; "
                "expected (M,) and (M, 3)."
            )
        check_number(
            self.seconds, "the length of a trail", above=0.0, unit="s", error=RunError
        )

    def points(self, time: float, *, on_board: bool = True) -> NDArray[np.float64]:
        """Return the points p_B of the trail at a time, every 20 ms, shape (k, 3), m.

        They are projected onto the board, or stay where they are.
        """
        times = np.asarray(self.times, dtype=float)
        path = np.asarray(self.positions, dtype=float)
        first = max(time - self.seconds, float(times[0]))
        at = np.arange(first, time, 0.02)
        x, y, z = (np.interp(at, times, path[:, i]) for i in range(3))
        return np.column_stack([x, y, 0 * z if on_board else z])


def paint_trail(
    color: NDArray[np.uint8],
    points: NDArray[np.float64],
    *,
    where: NDArray[np.bool_],
    X_CB: RigidTransform,
    focal: float,
    width: int,
) -> None:
    """Draw a line on the board into a picture, in place, fading towards its start.

    Parameters
    ----------
    color : ndarray of uint8, shape (height, width, 3)
    points : ndarray, shape (k, 3)
        In B, m.
    where : ndarray of bool, shape (height, width)
        The pixels that may be painted: those of the board.
    X_CB : RigidTransform
    focal : float
        Focal length, pixels.
    width : int
        Of the line, pixels.
    """
    if len(points) < 2:
        return
    height, across = where.shape
    p_C = points @ X_CB.rotation().matrix().T + X_CB.translation()
    if np.any(p_C[:, 2] < 1e-3):
        return
    pixels = focal * p_C[:, :2] / p_C[:, 2:] + [across / 2, height / 2]
    mask = Image.new("L", (across, height))
    draw = ImageDraw.Draw(mask)
    segments = np.array_split(np.arange(len(pixels)), _TRAIL_SEGMENTS)
    for number, segment in enumerate(segments, start=1):
        if len(segment):
            chosen = pixels[segment[0] : segment[-1] + 2]
            shade = round(255 * _MOST_ALPHA * number / _TRAIL_SEGMENTS)
            draw.line(
                [tuple(p) for p in chosen], fill=shade, width=width, joint="curve"
            )
    box = mask.getbbox()
    if box is None:
        return
    part = np.s_[box[1] : box[3], box[0] : box[2]]
    alpha = np.asarray(mask, dtype=np.float32)[part] / 255 * where[part]
    under = color[part].astype(np.float32)
    mixed = under + alpha[..., None] * (np.array(_TRAIL_COLOR) - under)
    color[part] = np.rint(mixed).astype(np.uint8)


def load_font(height: int) -> Any:
    """Return the font of captions, which Matplotlib brings along, for a picture."""
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), max(8, height // 30))


def draw_caption(picture: Image.Image, text: str, *, font: Any) -> None:
    """Draw a line of text into a picture, at its lower left."""
    margin = max(4, picture.height // 40)
    ImageDraw.Draw(picture).text(
        (margin, picture.height - margin),
        text,
        anchor="ls",
        font=font,
        fill=_CAPTION_COLOR,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Gauge:
    """A number that changes in a film, drawn as a bar with its value as text.

    Attributes
    ----------
    text : str
        Text above the bar, with a field for the value, as "force {:.1f} N".
    values : array_like, shape (N,)
        For each frame.
    most : float
        The value at the end of the bar.
    band : tuple of 2 floats, optional
        Desired range of the value.

    Examples
    --------
    >>> Gauge(text="cleaned {:.0f} %", values=[0.0, 43.6], most=100.0).text_of(1)
    'cleaned 44 %'
    """

    text: str
    values: ArrayLike
    most: float
    band: tuple[float, float] | None = None

    def text_of(self, frame: int) -> str:
        """Return the words of a frame."""
        return self.text.format(np.asarray(self.values)[frame])

    def draw(self, picture: Image.Image, frame: int, *, row: int, font: Any) -> None:
        """Draw the gauge of a frame into a picture, at its upper left.

        Parameters
        ----------
        picture : Image
        frame : int
        row : int
            0 for the uppermost gauge.
        font : Pillow font
        """
        high = font.size
        left = max(4, picture.height // 40)
        top = left + round(2.2 * high * row)
        width, bar = 9 * high, top + round(1.3 * high)
        draw = ImageDraw.Draw(picture)

        def box(start: float, end: float, color: str, inset: int) -> None:
            a, b = (left + width * min(max(x / self.most, 0), 1) for x in (start, end))
            draw.rectangle((a, bar + inset, b, bar + high // 2 - inset), fill=color)

        box(0.0, self.most, _EMPTY, 0)
        if self.band is not None:
            box(*self.band, _BAND, 0)
        value = float(np.asarray(self.values)[frame])
        if value > 0:
            box(0.0, value, _FULL, max(1, high // 8))
        draw.text((left, top), self.text_of(frame), font=font, fill=_TEXT)
