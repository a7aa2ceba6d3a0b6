"""How far a torque and its change are shortened, keeping their direction."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def torque_scale(torque: Array, *, lower: Array, upper: Array) -> float:
    """Return the factor, at most 1, that scales a torque into the box of limits.

    Parameters
    ----------
    torque : array, shape (n,)
        Joint torque, Nm.
    lower, upper : array, shape (n,)
        Limits, ``lower < 0 < upper``, Nm; infinite where there is none.
    """
    excess = max(np.maximum(torque / upper, torque / lower).tolist())
    return float(1 / excess) if excess > 1 else 1.0


def rate_scale(change: Array, *, max_change: float) -> float:
    """Return the factor, at most 1, by which a change of torque is shortened.

    Parameters
    ----------
    change : array, shape (n,)
        Wanted minus previous joint torque, Nm.
    max_change : float
        Greatest change of any joint, Nm.
    """
    return float(max_change / max(max_change, *map(abs, change.tolist())))
