"""Limits of a torque and of its rate that keep their direction."""

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


def limit_torque(torque: Array, *, lower: Array, upper: Array) -> Array:
    """Scale a torque, shape (n,), into the box of limits, keeping its direction."""
    scale = torque_scale(torque, lower=lower, upper=upper)
    return torque * scale if scale < 1 else torque


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


def limit_torque_rate(torque: Array, *, previous: Array, max_change: float) -> Array:
    """Scale the change since the previous torque, keeping its direction.

    Parameters
    ----------
    torque, previous : array, shape (n,)
        Wanted and previous joint torque, Nm.
    max_change : float
        Greatest change of any joint, Nm.

    Returns
    -------
    array, shape (n,)
        Limited joint torque, Nm.
    """
    change = torque - previous
    scale = rate_scale(change, max_change=max_change)
    return previous + scale * change if scale < 1 else torque
