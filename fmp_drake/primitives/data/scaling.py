"""Scales that let channels of different units live in one model."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import GREATEST, finite_array

ChannelScales = Literal["units"] | ArrayLike


def channel_scales(
    scales: ChannelScales, values: NDArray[np.float64], units: Sequence[str]
) -> NDArray[np.float64]:
    """Return the number that each channel is divided by before the fit, shape (D,).

    Parameters
    ----------
    scales : "units" or array_like, shape (D,)
        "units": 1 where all channels share one unit; else the standard deviation
        of all channels of a unit together (1 where they never change).
    values : ndarray, shape (..., D)
    units : sequence of str
        Of each channel.
    """
    d = values.shape[-1]
    if isinstance(scales, str):
        if scales != "units":
            raise SkillError(f"scales is {scales!r}; give 'units' or {d} numbers.")
        out = np.ones(d)
        if len(set(units)) > 1:
            variances = values.reshape(-1, d).var(axis=0)
            for unit in set(units):
                same = [i for i in range(d) if units[i] == unit]
                spread = float(np.sqrt(variances[same].mean()))
                out[same] = spread if spread > 0 else 1.0
        return out
    out = finite_array(scales, "the scales", (d,))
    if not np.all(out > 1 / GREATEST):
        raise SkillError(f"scales is {scales}; expected {d} positive numbers.")
    return out.copy()
