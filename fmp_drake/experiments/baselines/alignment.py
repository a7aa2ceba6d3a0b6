"""Alignment: recordings cut into periods of equal phase, as ProMP needs them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fmp_drake.errors import DemonstrationError, ExperimentError
from fmp_drake.primitives.model.phase.period import (
    autocorrelation,
    fundamental_period,
    parabola_top,
)

# A period may be this much shorter or longer than the mean one.
_TEMPO = 0.3
_CANDIDATES = 41
# Where the usual search refuses: greatest lag relative to the longest recording, least
# correlation, and the fraction of the highest peak that an earlier one must reach.
_LONGEST_LAG, _CORRELATED, _ALMOST = 0.78, 0.4, 0.8


def movement_period(recordings: Sequence[NDArray[np.float64]]) -> float:
    """Return the period of recordings (n, D), samples, also of only 1.4 cycles.

    Where `fundamental_period` refuses, it is the first high peak of the autocorrelation
    after its first zero crossing.

    Raises
    ------
    DemonstrationError
        Where nothing repeats.
    """
    if not recordings:
        raise ExperimentError("no recording is long enough; record several cycles.")
    try:
        return fundamental_period(recordings)
    except DemonstrationError:
        r = autocorrelation(
            recordings, longest=int(_LONGEST_LAG * max(map(len, recordings)))
        )
        lags = np.arange(1, len(r) - 1)
        peaks = lags[(r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:])]
        below = np.flatnonzero(r <= 0)
        peaks = peaks[peaks > below[0]] if len(below) else peaks[:0]
        if not len(peaks) or r[peaks].max() < _CORRELATED:
            raise
        first = peaks[np.argmax(r[peaks] >= _ALMOST * r[peaks].max())]
        return float(parabola_top(r, int(first)))


@dataclass(frozen=True, kw_only=True, eq=False)
class AlignedPeriods:
    """Periods that start at the same phase, each stretched to the same length.

    Attributes
    ----------
    values : ndarray, shape (N, T, D)
        One period each; sample T would be the first of the next.
    durations : ndarray, shape (N,)
        Samples that each period lasted.

    Examples
    --------
    >>> cosine = np.cos(2 * np.pi * np.arange(200) / 20)[:, None]
    >>> aligned = align_periods([cosine], period=20.0, n_steps=10)
    >>> aligned.values[0, [0, 5], 0].round(1)
    array([ 1., -1.])
    >>> float(aligned.durations.mean().round(2))
    20.0
    """

    values: NDArray[np.float64]
    durations: NDArray[np.float64]


def align_periods(
    recordings: Sequence[NDArray[np.float64]],
    *,
    period: float,
    n_steps: int,
    rounds: int = 4,
) -> AlignedPeriods:
    """Cut recordings (n, D) where each period starts, and resample the periods.

    A template of one period, first a part of the longest recording, is laid around
    every possible start; the next start is where it fits best, 0.7 to 1.3 periods
    after the last. The mean of the periods is the next template. The phase is 0
    where the channel that varies most is greatest.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    period : float
        Mean period, samples: see `fundamental_period`.
    n_steps : int
        T, samples of an aligned period.
    rounds : int
        Number of updates of the template.
    """
    long_enough = [y for y in recordings if len(y) >= 1.5 * period]
    if not long_enough:
        raise ExperimentError(
            f"no recording is longer than 1.5 periods of {period:.3g} samples; record "
            "several cycles in one go."
        )
    splines = [CubicSpline(np.arange(len(y)), y) for y in long_enough]
    ends = [len(y) - 1 for y in long_enough]
    longest = int(np.argmax(ends))
    start = (ends[longest] - period) / 2
    template = splines[longest](start + np.arange(n_steps) * period / n_steps)
    for number in range(rounds + 1):
        if number == rounds:  # The phase is fixed before the last round.
            strongest = int(np.argmax(np.ptp(template, axis=0)))
            template = np.roll(template, -np.argmax(template[:, strongest]), axis=0)
        values, durations = [], []
        for spline, end in zip(splines, ends, strict=True):
            starts = _starts(spline, end, template, period)
            lengths = np.diff(starts)
            phases = np.arange(n_steps) / n_steps
            values.append(spline(starts[:-1, None] + lengths[:, None] * phases))
            durations.append(lengths)
        periods = np.concatenate(values)
        if len(periods) < 2:
            raise ExperimentError(
                f"fewer than 2 full periods of {period:.3g} samples were found; record "
                "more cycles in one go."
            )
        template = periods.mean(axis=0)
    return AlignedPeriods(values=periods, durations=np.concatenate(durations))


def _starts(
    spline: CubicSpline, end: int, template: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """Return the starts of the periods in a recording, samples, ascending."""
    first = np.linspace(0, period, 2 * _CANDIDATES, endpoint=False)
    starts = [_best(spline, end, template, period, first)]
    while True:
        times = starts[-1] + period * np.linspace(1 - _TEMPO, 1 + _TEMPO, _CANDIDATES)
        times = times[times <= end]
        # A start that could lie beyond the end is not searched for.
        if len(times) < _CANDIDATES // 2:
            return np.array(starts)
        starts.append(_best(spline, end, template, period, times))


def _best(
    spline: CubicSpline,
    end: int,
    template: NDArray[np.float64],
    period: float,
    candidates: NDArray[np.float64],
) -> float:
    """Return the candidate around which the template fits best, between samples."""
    n = len(template)
    offsets = np.arange(n) - n // 2
    at = candidates[:, None] + offsets * period / n
    inside = (at >= 0) & (at <= end)
    error = spline(np.clip(at, 0, end)) - template[offsets % n]
    squares = np.sum(error**2, axis=2) * inside
    cost = squares.sum(axis=1) / inside.sum(axis=1)
    best = parabola_top(-cost, int(np.argmin(cost)))
    return float(candidates[0] + best * (candidates[1] - candidates[0]))
