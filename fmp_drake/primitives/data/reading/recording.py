"""What a file says of a movement, before it is a demonstration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Channels over time, perhaps with orientations.

    Attributes
    ----------
    time : ndarray, shape (N,)
        s.
    values : ndarray, shape (N, D)
    channels, units : tuple of str
        Of each channel.
    quaternions : ndarray, shape (N, 4), or None
        (x, y, z, w).
    frame : str
    remarks : tuple of str
        What was recognised, and what was left out.

    Examples
    --------
    >>> time = np.arange(4) / 20
    >>> Recording(time=time, values=time[:, None], channels=("x",), units=("m",)).frame
    ''
    """

    time: NDArray[np.float64]
    values: NDArray[np.float64]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    quaternions: NDArray[np.float64] | None = None
    frame: str = ""
    remarks: tuple[str, ...] = ()
