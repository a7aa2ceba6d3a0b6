"""Metrics of cleaning: remaining ink, missed spots, and times to clean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import as_floats
from fmp_drake.systems.ink.grid import CLEAN_BELOW, InkGrid, cleaned_fraction

type FloatArray = NDArray[np.float64]

_ALL_NEIGHBOURS = np.ones((3, 3))


@dataclass(frozen=True, kw_only=True)
class MissedSpots:
    """Remaining spots on an area that should have been cleaned.

    Attributes
    ----------
    cleaned_fraction : float
        Fraction of the area's cells with less than 10 % ink, from 0 to 1.
    count : int
        Number of spots: groups of cells that are not clean and touch one another
        at an edge or a corner. No spot is too small to count.
    area_cm2, largest_cm2 : float
        Area of all spots and of the largest in cm^2.

    Examples
    --------
    >>> from fmp_drake.systems import InkGrid
    >>> from fmp_drake.systems.ink.metrics import missed_spots
    >>> grid = InkGrid(size=(0.5, 0.7))
    >>> ink = np.zeros(grid.shape)
    >>> ink[10:14, 20:30] = 1.0
    >>> spots = missed_spots(ink, np.full(grid.shape, True), grid=grid)
    >>> spots.count, spots.area_cm2
    (1, 10.0)
    """

    cleaned_fraction: float
    count: int
    area_cm2: float
    largest_cm2: float


def missed_spots(ink: ArrayLike, mask: ArrayLike, *, grid: InkGrid) -> MissedSpots:
    """Return the number and area of the spots of an area that are not clean.

    Parameters
    ----------
    ink : array_like, shape (ny, nx) or (ny nx,)
        Ink at the end, from 0 to 1.
    mask : array_like of bool, same size
        The area that should be clean.
    grid : InkGrid
        The cells.

    Raises
    ------
    SystemsError
        If an array does not fit the grid.
    """
    values = grid.cells("ink", np.asarray(ink, dtype=float))
    area = grid.cells("mask", np.asarray(mask, dtype=bool))
    labels, count = ndimage.label(
        area & (values >= CLEAN_BELOW), structure=_ALL_NEIGHBOURS
    )
    cells = np.bincount(labels.ravel())[1:]
    cell_cm2 = 1e4 * float(np.prod(grid.pitch))
    return MissedSpots(
        cleaned_fraction=cleaned_fraction(values, area),
        count=int(count),
        area_cm2=cell_cm2 * int(cells.sum()),
        largest_cm2=cell_cm2 * int(cells.max(initial=0)),
    )


def cleaned_history(
    erase_time: ArrayLike,
    mask: ArrayLike,
    times: ArrayLike,
) -> FloatArray:
    """Return the fraction of an area that was clean at given times.

    Parameters
    ----------
    erase_time : array_like, shape (ny, nx) or (ny nx,)
        Time in seconds at which a cell became clean, `inf` for never: the
        output of `EraseTimes` at the end of a run.
    mask : array_like of bool, same size
        The cells to be cleaned.
    times : array_like, shape (num_times,)
        Times in seconds.

    Returns
    -------
    ndarray, shape (num_times,)
        Fraction from 0 to 1, equal to `cleaned_fraction` of the ink at that time; 1
        where there is nothing to be cleaned.
    """
    erased = np.asarray(erase_time, dtype=float).ravel()
    chosen = as_floats(np.ravel(mask), "the mask", erased.shape, error=SystemsError)
    moments = np.sort(erased[chosen > 0])
    if not moments.size:
        return np.ones(np.shape(times))
    clean = np.searchsorted(moments, np.asarray(times, dtype=float), side="right")
    fraction: FloatArray = clean / moments.size
    return fraction


def times_to_clean(times: ArrayLike, cleaned: ArrayLike) -> dict[float, float | None]:
    """Return the first times at which an area was clean to 50, 90 and 99 %.

    Parameters
    ----------
    times : array_like, shape (num_times,)
        Times in seconds, ascending.
    cleaned : array_like, shape (num_times,)
        Cleaned fraction at these times, from 0 to 1.

    Returns
    -------
    dict
        Maps each fraction to the first of the times at which it was reached, or to
        None.

    Raises
    ------
    SystemsError
        If the two arrays differ in length.
    """
    moments = np.asarray(times, dtype=float).ravel()
    what = "the cleaned fractions"
    history = as_floats(np.ravel(cleaned), what, moments.shape, error=SystemsError)
    reached: dict[float, float | None] = {}
    for fraction in (0.5, 0.9, 0.99):
        hits = np.flatnonzero(history >= fraction)
        reached[fraction] = float(moments[hits[0]]) if hits.size else None
    return reached
