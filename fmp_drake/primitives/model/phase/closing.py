"""Windows whose end leads back to their beginning."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# Of a window: what is not played at its end, and of that what is the movement's own.
_UNPLAYED = 0.1
_OWN = 0.3


def unplayed(n_steps: int) -> int:
    """Return how many samples at the end of a closed window are not to be played."""
    return int(_UNPLAYED * n_steps)


def closed(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lead the end of windows (..., T, D) back to their beginning.

    The Fourier series of a window is periodic. Where its last sample is far from its
    first, it rings between the samples, and so do its velocities, also far from the ends.
    So the last samples, which are not played, are replaced by the smoothest way: that of
    least third differences.
    """
    out = np.array(windows)
    bridge = _bridge(windows.shape[-2])
    out[..., len(bridge.T) :, :] = bridge @ windows[..., : len(bridge.T), :]
    return out


@lru_cache
def _bridge(n_steps: int) -> NDArray[np.float64]:
    """Return the matrix (L, T - L) from the first samples of a window to the last L."""
    first = n_steps - round((1 - _OWN) * unplayed(n_steps))
    rough = np.eye(n_steps)
    for _ in range(3):
        rough = rough - np.roll(rough, 1, axis=0)
    out: NDArray[np.float64] = np.linalg.lstsq(rough[:, first:], -rough[:, :first])[0]
    out.setflags(write=False)
    return out
