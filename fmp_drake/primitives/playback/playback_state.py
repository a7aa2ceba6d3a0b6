"""Where a playback stands."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaybackState:
    """Where a playback stands at a tick.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        The current Fourier weights w.
    target : ndarray, shape (D*T,)
        What the weights are brought to: a component's mean or a sample of it.
    component : int
        The tracked component j*.
    step : int
        The current sample of the window, K - 1 to T - 1.
    history : ndarray, shape (K, D)
        The desired values at the last K ticks, the newest last.
    offset : ndarray, shape (2, D)
        What the desired values and velocities still add to those of the weights.
    remaps : int
        How often the weights have been re-mapped.
    """

    weights: NDArray[np.float64]
    target: NDArray[np.float64]
    component: int
    step: int
    history: NDArray[np.float64]
    offset: NDArray[np.float64]
    remaps: int
