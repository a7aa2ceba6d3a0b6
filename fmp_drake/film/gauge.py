"""A number of each frame of a film, drawn as a bar with words."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw

_TEXT, _EMPTY, _FULL, _BAND = "#464C54", "#C9CED6", "#0072B2", "#7CC4A9"


@dataclass(frozen=True, kw_only=True, eq=False)
class Gauge:
    """A number that changes in a film: what it is, and its value in each frame.

    Attributes
    ----------
    text : str
        What stands above the bar, with a field for the value, as "force {:.1f} N".
    values : array_like, shape (N,)
        For each frame.
    most : float
        The value at the end of the bar.
    band : tuple of 2 floats, optional
        From where to where the value should be.

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
