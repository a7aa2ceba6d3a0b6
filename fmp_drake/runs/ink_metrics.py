"""The metrics of the ink: how much was cleaned, how soon, and what was missed."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.runs.metrics import Metrics
from fmp_drake.systems.ink.grid import CLEAN_BELOW, InkGrid, cleaned_fraction
from fmp_drake.systems.ink.metrics import (
    cleaned_history,
    missed_spots,
    times_to_clean,
)

# To which the times to 50, 90 and 99 % are rounded up, s.
_RESOLUTION = 0.05


def ink_metrics(
    *,
    ink: NDArray[np.float64],
    initial_ink: NDArray[np.float64],
    erase_time: NDArray[np.float64],
    area: NDArray[np.bool_],
    grid: InkGrid,
    seconds: float,
) -> Metrics:
    """Return the metrics at the end of a run; what was never reached is None.

    Parameters
    ----------
    ink, initial_ink, erase_time : ndarray, shape (ny, nx)
        What is left, what there was, and when a cell became clean, s, as
        `InkBoard` and `EraseTimes` say them.
    area : ndarray of bool, shape (ny, nx)
        The demonstrated area.
    grid : InkGrid
    seconds : float
        Length of the run.
    """
    inked = initial_ink >= CLEAN_BELOW
    wanted = area & inked
    spots = missed_spots(ink, wanted, grid=grid)
    times = _RESOLUTION * np.arange(int(seconds / _RESOLUTION) + 1)
    reached = times_to_clean(times, cleaned_history(erase_time, wanted, times))
    return {
        "cleaned_fraction": cleaned_fraction(ink, inked),
        "cleaned_fraction_of_demonstrated_area": spots.cleaned_fraction,
        **{f"seconds_to_{100 * f:.0f}_percent": t for f, t in reached.items()},
        "missed_spots": spots.count,
        "missed_area_cm2": spots.area_cm2,
        "missed_largest_cm2": spots.largest_cm2,
    }
