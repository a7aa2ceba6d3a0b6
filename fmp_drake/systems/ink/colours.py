"""The colours of ink on a whiteboard, the same on the page and in films."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

type FloatArray = NDArray[np.float64]

INK_COLOUR = (0.20, 0.38, 0.76)
"""Colour of full ink (linear RGB, 0 to 1): a pale blue marker. What is drawn on the
board in green, orange and violet can be told from it."""

BOARD_COLOUR = (1.0, 1.0, 1.0)
"""Colour towards which the ink fades (linear RGB, 0 to 1)."""


def ink_colours(ink: ArrayLike, *, srgb: bool = False) -> FloatArray:
    """Give each fraction of ink its colour: a mixture of ink and board.

    The mixture is made in linear light, as Meshcat does between vertices. To paint
    on a picture of a board under a lamp, multiply: `ink_colours(0)` is white.

    Parameters
    ----------
    ink : array_like
        Fraction of the ink that is left, from 0 to 1, of any shape, such as (ny, nx).
    srgb : bool
        Return sRGB, as in pictures, in place of linear RGB.

    Returns
    -------
    ndarray, shape (..., 3)
        Red, green and blue from 0 to 1.
    """
    left = np.clip(np.asarray(ink, dtype=float), 0.0, 1.0)[..., np.newaxis]
    board = np.array(BOARD_COLOUR)
    linear: FloatArray = board + left * (np.array(INK_COLOUR) - board)
    if not srgb:
        return linear
    # IEC 61966-2-1.
    encoded: FloatArray = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055
    )
    return encoded
