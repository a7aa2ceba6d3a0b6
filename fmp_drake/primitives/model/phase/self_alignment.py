"""Alignment of a recording with itself, one period later."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices, Mask
from fmp_drake.primitives.model.phase.period import LONGEST_LAG, SHORTEST_LAG

# Squared distance, relative to the variance of the states in one lag, up to which states are
# similar, and the cost of a change of the lag by one sample; a sample at the mean speed gains
# at most 1. From 0.12 to 0.3, and from 0.2 to 1, the periods of real recordings are the same.
_SIMILAR, _CHANGE_COST = 0.2, 0.5
# Bounds of the gain of a sample, and of its speed relative to the root mean square.
_LEAST_GAIN, _MOST_SPEED = -5.0, 2.0
# Lag relative to half the interval of a difference quotient.
_LAGS_PER_STEP = 24
# Least number of cycles in a recording.
_LEAST_CYCLES = 1.25
# Most pairs of samples that are compared; they take a gigabyte.
_MOST_PAIRS = 1.2e8
# Greatest ratio of lags of one period.
_SAME_PERIOD = 1.25
# Least score of an alignment, in periods: for a recording of one period, its increment for
# twice as long a recording, in which chance similarity is likelier, and for a known period.
# With them 1 in 80 smooth random paths has a rhythm.
_LEAST_SCORE, _SCORE_PER_DOUBLING, _LEAST_OF_KNOWN = 0.12, 0.06, 0.1


class Alignment(NamedTuple):
    """Part of a recording that is similar to a later part of it.

    Attributes
    ----------
    score : float
        Number of similar samples, at the mean speed; less where they differ.
    start, end : int
        First sample of the earlier part, and the one after the last of the later part.
    period : float
        Mean lag between the two parts, samples.
    """

    score: float
    start: int
    end: int
    period: float


def aligned_period(recordings: Sequence[Array]) -> float | None:
    """Return the period, in samples, of the best alignment of recordings (n, D).

    About a fifth of a cycle must recur, more in long recordings; None if less does.
    """
    alignments = [
        alignment
        for y in recordings
        for alignment in self_alignments(
            y, SHORTEST_LAG, min(LONGEST_LAG, len(y) / _LEAST_CYCLES), most=1
        )
    ]
    if not alignments:
        return None
    best = max(alignments)
    doublings = np.log2(sum(map(len, recordings)) / best.period)
    least = (_LEAST_SCORE + _SCORE_PER_DOUBLING * doublings) * best.period
    return best.period if best.score > least else None


def aligned_samples(recordings: Sequence[Array], period: float) -> list[Mask]:
    """Return masks (n,) of the samples of recordings (n, D) in alignments of a period.

    They are all samples where no part is aligned, or where cycles are very long.
    """
    least, most = period / _SAME_PERIOD, period * _SAME_PERIOD
    alignments = [
        self_alignments(y, least, most, least=_LEAST_OF_KNOWN)
        if len(y) * (most - least) < _MOST_PAIRS
        else []
        for y in recordings
    ]
    masks = [np.full(len(y), not any(alignments)) for y in recordings]
    for mask, found in zip(masks, alignments, strict=True):
        for alignment in found:
            mask[alignment.start : alignment.end] = True
    return masks


def self_alignments(
    recording: Array,
    shortest: float,
    longest: float,
    *,
    least: float = 0.0,
    most: int | None = None,
) -> list[Alignment]:
    """Return disjoint alignments of a recording (n, D) with itself, the best one first.

    An alignment is local (Smith and Waterman): dynamic programming finds the start, the end
    and the lag of each sample together. Positions and velocities are compared.
    Rest does not score, and a slow approach to the movement is not similar to it.

    Parameters
    ----------
    recording : ndarray, shape (n, D)
    shortest, longest : float
        Bounds of the lag, samples.
    least : float
        Least score, in periods.
    most : int, optional
        Greatest number of alignments.
    """
    lags = np.arange(round(shortest), min(round(longest), len(recording) - 3) + 1)
    out: list[Alignment] = []
    gains = _gains(recording - recording.mean(axis=0), lags)
    while len(lags) and (most is None or len(out) < most):
        scores, starts, ends, first_lags = _best_paths(gains)
        best = int(np.argmax(scores))
        period = float(lags[first_lags[best]] + lags[best]) / 2
        if scores[best] <= least * period:
            break
        start, end = int(starts[best]), int(ends[best] + lags[best]) + 1
        out.append(Alignment(float(scores[best]), start, end, period))
        gains[max(0, start - lags[best]) : end] = _LEAST_GAIN
    return out


@compiled
def _gains(values: Array, lags: Indices) -> Array:
    """Return the gain of each pair of samples, by earlier sample and lag, (n, M).

    It is 1 for equal states at the mean speed, 0 at rest, and negative for different states.
    """
    n, d = values.shape
    gains = np.full((n, len(lags)), _LEAST_GAIN)
    # Values, velocities, and the squared lengths of the states and the velocities.
    numbers, sums = np.empty((n, 2 * d + 2)), np.zeros((n + 1, 2 * d + 2))
    for column, lag in enumerate(lags):
        step = max(1, lag // _LAGS_PER_STEP)
        for i in range(n):
            before, after = max(i - step, 0), min(i + step, n - 1)
            energy, square = 0.0, 0.0
            for c in range(d):
                velocity = (values[after, c] - values[before, c]) / (after - before)
                rate = lag / (2 * np.pi) * velocity
                numbers[i, c], numbers[i, d + c] = values[i, c], rate
                energy += values[i, c] ** 2 + rate**2
                square += velocity**2
            numbers[i, 2 * d], numbers[i, 2 * d + 1] = energy, square
            for c in range(2 * d + 2):
                sums[i + 1, c] = sums[i, c] + numbers[i, c]
        for i in range(n - lag):
            j, width = i + lag, lag + 1
            variance = (sums[j + 1, 2 * d] - sums[i, 2 * d]) / width
            mean_square = (sums[j + 1, 2 * d + 1] - sums[i, 2 * d + 1]) / width
            distance = 0.0
            for c in range(2 * d):
                variance -= ((sums[j + 1, c] - sums[i, c]) / width) ** 2
                distance += (numbers[j, c] - numbers[i, c]) ** 2
            square = max(numbers[j, 2 * d + 1], numbers[i, 2 * d + 1])
            speed = np.sqrt(square / max(mean_square, 1e-300))
            gain = 1 - distance / (_SIMILAR * max(variance, 1e-300))
            gains[i, column] = max(gain * min(speed, _MOST_SPEED), _LEAST_GAIN)
    return gains


@compiled
def _best_paths(gains: Array) -> tuple[Array, Indices, Indices, Indices]:
    """Return the best path by `_gains` that ends at each lag: score, start, end, first lag."""
    n, count = gains.shape
    best = np.zeros(count)
    best_starts, best_ends, best_firsts = np.zeros((3, count), dtype=np.int64)
    scores, starts, firsts = np.zeros(count), best_starts.copy(), best_starts.copy()
    new_scores, new_starts, new_firsts = scores.copy(), starts.copy(), firsts.copy()
    for i in range(n):
        for lag in range(count):
            score, source = scores[lag], lag
            for other in (lag - 1, lag + 1):
                if 0 <= other < count and scores[other] - _CHANGE_COST > score:
                    score, source = scores[other] - _CHANGE_COST, other
            is_continued = score > 0
            new_scores[lag] = max(score + gains[i, lag], 0.0)
            new_starts[lag] = starts[source] if is_continued else i
            new_firsts[lag] = firsts[source] if is_continued else lag
            if new_scores[lag] > best[lag]:
                best[lag], best_ends[lag] = new_scores[lag], i
                best_starts[lag], best_firsts[lag] = new_starts[lag], new_firsts[lag]
        scores, new_scores = new_scores, scores
        starts, new_starts = new_starts, starts
        firsts, new_firsts = new_firsts, firsts
    return best, best_starts, best_ends, best_firsts
