"""Ways to a movement and away from it, at the ends of a recording."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

# How much farther from the rest than nearly all of it is from itself.
_FAR = 3.0
_NEARLY_ALL = 0.95
# Samples that are looked at: in the middle, and at most at each end.
_LOOKED_AT = 400
_LONGEST = 2000


def without_approach(values: NDArray[np.float64], *, apart: int) -> slice:
    """Return the part of a recording (n, D) that lies where the movement comes again.

    What leads there, and away at the end, is where the recording never is at another
    time. It is left out if it comes from far.

    Parameters
    ----------
    values : ndarray, shape (n, D)
    apart : int
        Samples; what is nearer in time does not count as another time.
    """
    n = len(values)
    if n <= 2 * apart:
        return slice(0, n)
    middle = np.unique(np.linspace(n // 4, n - 1 - n // 4, _LOOKED_AT).astype(int))
    usual = np.quantile(_nearest(values, middle, apart), _NEARLY_ALL)
    ends = []
    for towards in (values, values[::-1]):
        distance = _nearest(towards, np.arange(min(n // 2, _LONGEST)), apart)
        length = int(np.argmax(distance <= usual))
        far = float(np.max(distance[:length], initial=0)) > _FAR * usual
        ends.append(length if far else 0)
    return slice(ends[0], n - ends[1])


def _nearest(
    values: NDArray[np.float64], index: NDArray[np.int64], apart: int
) -> NDArray[np.float64]:
    """Return how near each sample is to those at another time, shape of the index."""
    distance = cdist(values[index], values)
    distance[np.abs(index[:, None] - np.arange(len(values))) < apart] = np.inf
    out: NDArray[np.float64] = distance.min(axis=1)
    return out
