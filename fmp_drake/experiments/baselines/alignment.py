"""Alignment of recordings: periods that start at the same phase, as ProMP needs them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from fmp_drake.errors import DemonstrationError, ExperimentError
from fmp_drake.numeric import Array
from fmp_drake.primitives.model.phase.period import (
    autocorrelation,
    fundamental_period,
    parabola_top,
)

# Greatest difference of a period from the mean one, as a fraction of it; candidates for
# the start of the next period; updates of the template.
_TEMPO_RANGE, _CANDIDATES, _UPDATES = 0.3, 41, 4
# Search in recordings that are too short for `fundamental_period`: greatest lag relative
# to the longest recording, least correlation, and the fraction of the highest peak that
# an earlier one must reach.
_LONGEST_LAG, _LEAST_CORRELATION, _PEAK_FRACTION = 0.78, 0.4, 0.8


def movement_period(recordings: Sequence[Array]) -> float:
    """Return the period of recordings (n, D) of at least 1.4 cycles, samples.

    Recordings that are too short for `fundamental_period` have the period of the first
    high peak of their autocorrelation after its first zero crossing.

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
        zeros = np.flatnonzero(r <= 0)
        peaks = peaks[peaks > zeros[0]] if len(zeros) else peaks[:0]
        if not len(peaks) or r[peaks].max() < _LEAST_CORRELATION:
            raise
        first = peaks[np.argmax(r[peaks] >= _PEAK_FRACTION * r[peaks].max())]
        return float(parabola_top(r, int(first)))


@dataclass(frozen=True, kw_only=True, eq=False)
class AlignedPeriods:
    """Periods that start at the same phase, each stretched to the same length.

    Attributes
    ----------
    values : ndarray, shape (N, T, D)
        One period each; sample T would be the first one of the next period.
    durations : ndarray, shape (N,)
        Duration of each period, samples.

    Examples
    --------
    >>> cosine = np.cos(2 * np.pi * np.arange(200) / 20)[:, None]
    >>> aligned = align_periods([cosine], period=20.0, n_steps=10)
    >>> aligned.values[0, [0, 5], 0].round(1)
    array([ 1., -1.])
    >>> float(aligned.durations.mean().round(2))
    20.0
    """

    values: Array
    durations: Array


def align_periods(
    recordings: Sequence[Array],
    *,
    period: float,
    n_steps: int,
) -> AlignedPeriods:
    """Cut recordings (n, D) at the start of each period, and resample the periods.

    A template of one period, at first a part of the longest recording, is compared with
    the recording around each possible start. The next start is the best fit 0.7 to 1.3
    periods after the last one. The mean of the periods is the next template. Phase 0 is
    the maximum of the channel with the largest range.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    period : float
        Mean period, samples: see `fundamental_period`.
    n_steps : int
        T, samples of an aligned period.
    """
    recordings = [y for y in recordings if len(y) >= 1.5 * period]
    if not recordings:
        raise ExperimentError(
            f"no recording is longer than 1.5 periods of {period:.3g} samples; record "
            "several consecutive cycles."
        )
    splines = [CubicSpline(np.arange(len(y)), y) for y in recordings]
    ends = [len(y) - 1 for y in recordings]
    longest = int(np.argmax(ends))
    start = (ends[longest] - period) / 2
    template = splines[longest](start + np.arange(n_steps) * period / n_steps)
    for number in range(_UPDATES + 1):
        if number == _UPDATES:  # The phase is shifted before the last update.
            widest = int(np.argmax(np.ptp(template, axis=0)))
            template = np.roll(template, -np.argmax(template[:, widest]), axis=0)
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
                f"there are fewer than 2 full periods of {period:.3g} samples; record more "
                "consecutive cycles."
            )
        template = periods.mean(axis=0)
    return AlignedPeriods(values=periods, durations=np.concatenate(durations))


def _starts(spline: CubicSpline, end: int, template: Array, period: float) -> Array:
    """Return the starts of the periods in a recording, samples, ascending."""
    n = len(template)
    offsets = np.arange(n) - n // 2

    def best_start(candidates: Array) -> float:
        """Return the time between samples around which the template fits best."""
        times = candidates[:, None] + offsets * period / n
        is_inside = (times >= 0) & (times <= end)
        errors = spline(np.clip(times, 0, end)) - template[offsets % n]
        squares = np.sum(errors**2, axis=2) * is_inside
        cost = squares.sum(axis=1) / is_inside.sum(axis=1)
        best = parabola_top(-cost, int(np.argmin(cost)))
        return float(candidates[0] + best * (candidates[1] - candidates[0]))

    starts = [best_start(np.linspace(0, period, 2 * _CANDIDATES, endpoint=False))]
    factors = np.linspace(1 - _TEMPO_RANGE, 1 + _TEMPO_RANGE, _CANDIDATES)
    while True:
        candidates = starts[-1] + period * factors
        candidates = candidates[candidates <= end]
        # The next start may be beyond the end.
        if len(candidates) < _CANDIDATES // 2:
            return np.array(starts)
        starts.append(best_start(candidates))
