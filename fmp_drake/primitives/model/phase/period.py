"""The fundamental period of recordings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError

# Samples.
_SHORTEST = 4.0
# A peak this close to the highest one, and earlier, is the fundamental's.
_ALMOST = 0.8
_LEAST_CORRELATION = 0.2
_MOST_PERIODS = 8
_FIRST_PEAKS = 3


def autocorrelation(
    recordings: Sequence[NDArray[np.float64]], *, longest: int
) -> NDArray[np.float64]:
    """Return the autocorrelation of recordings (n, D) at lags 0 to `longest`.

    Of all channels together, each counting by its variance, and normalised by the
    energies of the two parts that a lag compares, so that it does not fall with
    the lag. A trend is removed from every recording.
    """
    from scipy.signal import detrend  # Slow to import.

    above, first, second = np.zeros((3, longest + 1))
    for recording in recordings:
        n = len(recording)
        y = detrend(recording, axis=0)
        size = 2 ** int(np.ceil(np.log2(2 * n)))
        power = np.abs(np.fft.rfft(y, size, axis=0)) ** 2
        products = np.fft.irfft(power.sum(axis=1), size)
        energy = np.concatenate([[0.0], np.cumsum(np.sum(y**2, axis=1))])
        lags = np.arange(min(longest, n - 1) + 1)
        above[lags] += products[lags]
        first[lags] += energy[n - lags]
        second[lags] += energy[n] - energy[lags]
    norm = np.sqrt(first * second)
    return np.where(norm > 1e-12 * norm[0], above, 0) / np.where(norm > 0, norm, 1.0)


def fundamental_period(
    recordings: Sequence[NDArray[np.float64]], *, shortest: float = _SHORTEST
) -> float:
    """Return the period, in samples, after which all channels repeat together.

    The first of the highest peaks of the autocorrelation. It is refined by a parabola,
    and by its multiples, up to the eighth, as far as they are correlated: so it is the
    mean over many periods where their lengths vary.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    shortest : float
        Samples; shorter periods are not looked for.

    Raises
    ------
    DemonstrationError
        Where nothing repeats: a period must fit 1.7 times into the longest recording.
    """
    return _fundamental(_correlated(recordings, shortest), shortest)


def possible_periods(
    recordings: Sequence[NDArray[np.float64]], *, shortest: float = 8.0
) -> list[float]:
    """Return the fundamental period, in samples, and others that a movement may have.

    These grow: fractions and multiples of the first, from `shortest` on, and the first
    peaks of the autocorrelation. Where the tempo changes a lot, later and higher peaks tell
    when a tempo comes back, not a place.

    Raises
    ------
    DemonstrationError
        As for `fundamental_period`.
    """
    r = _correlated(recordings, _SHORTEST)
    period, longest = _fundamental(r, _SHORTEST), len(r) - 2
    inner = np.arange(1, longest + 1)
    peaks = inner[(r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:]) & (r[1:-1] > 0)]
    first = [parabola_top(r, int(top)) for top in peaks[:_FIRST_PEAKS]]
    found = [period]
    for each in sorted([*first, period / 3, period / 2, 2 * period, 3 * period]):
        different = all(abs(each - p) > 0.05 * p for p in found)
        if different and shortest <= each <= longest:
            found.append(each)
    return found


def _correlated(
    recordings: Sequence[NDArray[np.float64]], shortest: float
) -> NDArray[np.float64]:
    """Return the autocorrelation up to a lag after the longest period, (longest + 2,)."""
    longest_recording = max((len(y) for y in recordings), default=0)
    longest = int(0.6 * longest_recording)
    if longest < shortest + 2:
        raise DemonstrationError(
            f"the longest recording has {longest_recording} samples; at least "
            f"{int(np.ceil((shortest + 2) / 0.6))} are needed to find a period."
        )
    return autocorrelation(recordings, longest=longest + 1)


def _fundamental(r: NDArray[np.float64], shortest: float) -> float:
    """Return the period that an autocorrelation shows; see `fundamental_period`."""
    longest = len(r) - 2
    inner = np.arange(1, longest + 1)
    peaks = inner[(r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:]) & (inner >= shortest)]
    # Before it was first uncorrelated a signal resembles itself anyway.
    crossed = np.flatnonzero(r <= 0.0)
    dip = int(crossed[0]) if len(crossed) else int(np.argmin(r[: longest + 1]))
    peaks = peaks[peaks >= dip]
    if not len(peaks) or r[peaks].max() < _LEAST_CORRELATION:
        best = float(r[peaks].max()) if len(peaks) else 0.0
        raise DemonstrationError(
            f"no period from {shortest:g} to {longest} samples was found (the best "
            f"correlates with {best:.2f}); record at least two full cycles."
        )
    first = int(peaks[np.argmax(r[peaks] >= _ALMOST * r[peaks].max())])
    period = parabola_top(r, first)
    for k in range(2, _MOST_PERIODS + 1):
        lag = k * period
        low, high = int(lag - period / 4), int(np.ceil(lag + period / 4))
        if high > longest:
            break
        top = low + int(np.argmax(r[low : high + 1]))
        if top in (low, high) or r[top] < 0.7 * r[first]:
            break
        period = parabola_top(r, top) / k
    return period


def parabola_top(values: NDArray[np.float64], top: int) -> float:
    """Return where the parabola through a peak of values (n,) and its neighbours peaks.

    The peak itself where it is the first or the last value.
    """
    if not 0 < top < len(values) - 1:
        return top
    before, here, after = values[top - 1 : top + 2]
    curvature = before - 2 * here + after
    return top if curvature >= 0 else top + 0.5 * float((before - after) / curvature)
