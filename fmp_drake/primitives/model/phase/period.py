"""The period of recordings."""

from collections.abc import Sequence

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array

# Shortest period, samples.
_SHORTEST = 4.0
# An earlier peak of at least this fraction of the highest one is the fundamental's.
_ALMOST = 0.8
_LEAST_CORRELATION = 0.2
_MOST_PERIODS = 8
_FIRST_PEAKS = 3
# Similarity of neighbouring cycles that counts as a repetition.
SIMILAR = 0.55
# Variance of a segment, relative to the recording, below which it is at rest.
_LEAST_ENERGY = 0.02
SHORTEST_LAG, LONGEST_LAG = 8, 1200
"""Bounds of the lags at which recordings are compared with themselves, samples."""
# Relative step of lags.
_LAG_STEP = 0.02
# Fraction of the spectrum below the cutoff of the filter before resampling.
_BAND = 0.8
# Score of a candidate relative to the best.
_NOTABLE = 0.3


def noise_fractions(recordings: Sequence[Array]) -> Array:
    """Return the fraction of white noise in each channel of recordings, shape (D,).

    It is the flatness of the spectrum, the ratio of its geometric to its arithmetic
    mean, relative to that of white noise: a movement has a few high spectral lines.
    """
    powers = []
    for recording in recordings:
        y = (recording - recording.mean(axis=0)) * np.hanning(len(recording))[:, None]
        power = np.abs(np.fft.rfft(y, axis=0)) ** 2
        powers.append(power[1 : max(2, int(_BAND * len(power)))])
    power = np.concatenate(powers) + 1e-300
    mean = np.exp(np.mean(np.log(power), axis=0) + np.euler_gamma)
    return mean / power.mean(axis=0)


def autocorrelation(recordings: Sequence[Array], *, longest: int) -> Array:
    """Return the autocorrelation of recordings (n, D) at lags 0 to `longest`.

    All channels count by their variances. It is normalised by the energies of the two
    parts that a lag compares, so that it does not decrease with the lag. A trend is
    removed from every recording.
    """
    from scipy.signal import detrend  # Slow to import.

    sums, earlier, later = np.zeros((3, longest + 1))
    for recording in recordings:
        n = len(recording)
        y = detrend(recording, axis=0)
        size = 2 ** int(np.ceil(np.log2(2 * n)))
        power = np.abs(np.fft.rfft(y, size, axis=0)) ** 2
        products = np.fft.irfft(power.sum(axis=1), size)
        energy = np.concatenate([[0.0], np.cumsum(np.sum(y**2, axis=1))])
        lags = np.arange(min(longest, n - 1) + 1)
        sums[lags] += products[lags]
        earlier[lags] += energy[n - lags]
        later[lags] += energy[n] - energy[lags]
    norm = np.sqrt(earlier * later)
    return np.where(norm > 1e-12 * norm[0], sums, 0) / np.where(norm > 0, norm, 1.0)


def fundamental_period(recordings: Sequence[Array]) -> float:
    """Return the period, in samples, after which all channels repeat together.

    It is the first of the highest peaks of the autocorrelation, refined by a parabola
    and by its multiples up to the eighth, as far as they are correlated. Where the
    duration of cycles varies, it is therefore the mean of many periods.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)

    Raises
    ------
    DemonstrationError
        If nothing repeats. A period must fit 1.7 times into the longest recording.
    """
    return _fundamental(_correlated(recordings))


def possible_periods(recordings: Sequence[Array]) -> list[float]:
    """Return the fundamental period and other candidates, in samples.

    The others increase: fractions and multiples of the first, and the first peaks of the
    autocorrelation. Where the tempo varies a lot, a later and higher peak may be the
    period of its variation.

    Raises
    ------
    DemonstrationError
        As for `fundamental_period`.
    """
    r = _correlated(recordings)
    period, longest = _fundamental(r), len(r) - 2
    inner = np.arange(1, longest + 1)
    peaks = inner[(r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:]) & (r[1:-1] > 0)]
    first_peaks = [parabola_top(r, int(top)) for top in peaks[:_FIRST_PEAKS]]
    periods = [period]
    for other in sorted([*first_peaks, period / 3, period / 2, 2 * period, 3 * period]):
        is_new = all(abs(other - p) > 0.05 * p for p in periods)
        if is_new and SHORTEST_LAG <= other <= longest:
            periods.append(other)
    return periods


def _correlated(recordings: Sequence[Array]) -> Array:
    """Return the autocorrelation up to a lag after the longest period, (longest + 2,)."""
    longest_recording = max((len(y) for y in recordings), default=0)
    longest = int(0.6 * longest_recording)
    if longest < _SHORTEST + 2:
        raise DemonstrationError(
            f"the longest recording has {longest_recording} samples; at least "
            f"{int(np.ceil((_SHORTEST + 2) / 0.6))} are needed to find a period."
        )
    return autocorrelation(recordings, longest=longest + 1)


def _fundamental(r: Array) -> float:
    """Return the period of an autocorrelation; see `fundamental_period`."""
    longest = len(r) - 2
    inner = np.arange(1, longest + 1)
    peaks = inner[(r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:]) & (inner >= _SHORTEST)]
    # A peak before the first zero crossing is not a period.
    crossed = np.flatnonzero(r <= 0.0)
    dip = int(crossed[0]) if len(crossed) else int(np.argmin(r[: longest + 1]))
    peaks = peaks[peaks >= dip]
    if not len(peaks) or r[peaks].max() < _LEAST_CORRELATION:
        best = float(r[peaks].max()) if len(peaks) else 0.0
        raise DemonstrationError(
            f"no period from {_SHORTEST:g} to {longest} samples was found (the best "
            f"correlates with {best:.2f}); record at least two full cycles."
        )
    fundamental = int(peaks[np.argmax(r[peaks] >= _ALMOST * r[peaks].max())])
    period = parabola_top(r, fundamental)
    for k in range(2, _MOST_PERIODS + 1):
        lag = k * period
        low, high = int(lag - period / 4), int(np.ceil(lag + period / 4))
        if high > longest:
            break
        top = low + int(np.argmax(r[low : high + 1]))
        if top in (low, high) or r[top] < 0.7 * r[fundamental]:
            break
        period = parabola_top(r, top) / k
    return period


def parabola_top(values: Array, top: int) -> float:
    """Return the vertex of the parabola through a peak of values (n,) and its neighbours.

    It is the peak itself if that is the first or the last value.
    """
    if not 0 < top < len(values) - 1:
        return top
    before, here, after = values[top - 1 : top + 2]
    curvature = before - 2 * here + after
    return top if curvature >= 0 else top + 0.5 * float((before - after) / curvature)


@compiled
def similarity(values: Array, lag: int, width: int) -> Array:
    """Return how similar each segment (width, D) is to the one a lag later.

    It is 1 minus their squared distance relative to their variance about the common mean:
    1 for equal segments, 0 or less for a path that leads away or a segment at rest.

    Parameters
    ----------
    values : ndarray, shape (n, D)
    lag, width : int
        Samples.

    Returns
    -------
    ndarray, shape (n - lag - width + 1,)
    """
    (n, d), span = values.shape, lag + width
    # Of the samples before each one: values, their squares, and those of their changes.
    sums = np.zeros((n + 1, d + 2))
    for i in range(n):
        square, change = 0.0, 0.0
        for c in range(d):
            sums[i + 1, c] = sums[i, c] + values[i, c]
            square += values[i, c] ** 2
            if i + lag < n:
                change += (values[i + lag, c] - values[i, c]) ** 2
        sums[i + 1, d], sums[i + 1, d + 1] = (
            sums[i, d] + square,
            sums[i, d + 1] + change,
        )
    variance = sums[n, d] / n
    for c in range(d):
        variance -= (sums[n, c] / n) ** 2
    similar = np.zeros(max(n - span + 1, 0))
    for i in range(len(similar)):
        energy = 0.0
        for start in (i, i + lag):
            energy += sums[start + width, d] - sums[start, d]
            for c in range(d):
                mean = (sums[i + span, c] - sums[i, c]) / span
                total = sums[start + width, c] - sums[start, c]
                energy += mean * (width * mean - 2 * total)
        if energy > _LEAST_ENERGY * width * variance:
            distance = sums[i + width, d + 1] - sums[i, d + 1]
            similar[i] = 1 - distance / max(energy, 1e-300)
    return similar


def local_periods(recordings: Sequence[Array]) -> list[float]:
    """Return candidates of the period, in samples, the most likely first.

    They are found from similar neighbouring segments, so other parts of a recording,
    such as an approach, a pause or another bout, do not matter.
    """
    longest = min(LONGEST_LAG, max(map(len, recordings)) // 2)
    if longest < SHORTEST_LAG + 2:
        return []
    count = int(np.log(longest / SHORTEST_LAG) / np.log(1 + _LAG_STEP)) + 2
    lags = np.unique(np.geomspace(SHORTEST_LAG, longest, count).astype(int))
    scores = np.zeros(len(lags))
    for i, lag in enumerate(lags.tolist()):
        for y in recordings:
            similar = similarity(y, lag, lag)
            scores[i] += np.sum(similar[similar > SIMILAR] ** 2)
    if not scores.max() > 0:
        return []
    padded = np.concatenate([[-1.0], scores, [-1.0]])
    peaks = np.flatnonzero((scores >= padded[:-2]) & (scores > padded[2:]))
    peaks = peaks[scores[peaks] >= _NOTABLE * scores.max()]
    best = peaks[np.argmax(scores[peaks] >= _ALMOST * scores.max())]
    return [float(lags[best]), *(float(lags[p]) for p in peaks if p != best)]
