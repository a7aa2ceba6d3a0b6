"""Segmentation of recordings by a cycle, in both directions of time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from fmp_drake.numeric import Array, Indices, Mask, runs
from fmp_drake.primitives.model.phase.cycle import Cycle, harmonics_of
from fmp_drake.primitives.model.phase.tracking import (
    FASTEST,
    best_labels,
    first_cycles,
    phase_states,
)

# Standard deviation of the phase velocity, relative to the mean.
_VELOCITY_SPREAD = 0.2
# Bounds of the moving phase velocity, relative to the mean.
_TEMPOS = (0.5, 2.0)
# Period relative to half the interval of a difference quotient.
_STEPS_PER_PERIOD = 24
# Standard deviations of position and velocity from the cycle, relative to their own: those
# that are assumed at first, and the least ones.
_FIRST_DEVIATIONS, _LEAST_DEVIATIONS = (0.2, 0.3), (0.07, 0.15)
# Least variance of a cycle, which is 0 where nothing moves.
_LEAST_VARIANCE = 1e-18
# Cost of a sample beside the cycle: the squared number of standard deviations that is equally
# unlikely. It is less below a speed, relative to that of the cycle, and 0 at rest. A change of
# the label costs as much as a number of periods beside the cycle.
_OUTSIDE, _REST_SPEED, _CHANGE = 9.0, 0.3, 0.2
# Number of initial cycles that are compared, greatest number of iterations, and harmonics.
_INITIAL_CYCLES, _ROUNDS, _HARMONICS = 2, 3, 12
FORWARDS, BACKWARDS, OUTSIDE = 0, 1, 2
"""Labels of samples that follow a cycle, follow it backwards, or do not follow it."""


class Segmentation(NamedTuple):
    """Labels of the samples of recordings, and their phases on the cycle.

    Attributes
    ----------
    labels : list of ndarray, shape (n,)
        `FORWARDS`, `BACKWARDS` or `OUTSIDE`.
    phases : list of ndarray, shape (n,)
        rad, from 0 to 2 pi; those of the reversed cycle for `BACKWARDS`.
    cost : float
        Sum of the squared numbers of standard deviations.
    """

    labels: list[Indices]
    phases: list[Array]
    cost: float

    def in_longer_direction(self) -> "Segmentation":
        """Return the segmentation whose cycle has the direction of more samples."""
        counts = np.bincount(np.concatenate(self.labels), minlength=3)
        if counts[BACKWARDS] <= counts[FORWARDS]:
            return self
        swapped = np.array([BACKWARDS, FORWARDS, OUTSIDE])
        return self._replace(labels=[swapped[label] for label in self.labels])


def segment(
    recordings: Sequence[Array], masks: Sequence[Mask], period: float
) -> Segmentation | None:
    """Segment recordings (n, D) into motion along a cycle, backwards, and other parts.

    Viterbi training alternates: dynamic programming finds the cheapest labels and phases for
    a cycle, to which the cycle and the deviations from it are fitted. Positions and
    velocities are compared. Slow changes of centre, size and tempo do not matter. None where
    no cycle is found.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    masks : sequence of ndarray, shape (n,)
        Samples that repeat, from which the first cycle is chosen.
    period : float
        Samples.
    """
    size = round(period)
    values = [
        _normalised(y, np.zeros_like(y), mask, size)
        for y, mask in zip(recordings, masks, strict=True)
    ]
    parts = segments(values, masks)
    if max(map(len, parts), default=0) < period + 1:
        return None
    tempos = [np.ones(len(y)) for y in recordings]
    segmentations = [
        _Segmenter(cycle, _FIRST_DEVIATIONS, period).segment(values, tempos)
        for cycle in first_cycles(parts, period, most=_INITIAL_CYCLES)
    ]
    best = min(segmentations, key=lambda s: s.cost).in_longer_direction()
    for _ in range(_ROUNDS):
        masks = [label == FORWARDS for label in best.labels]
        if sum(map(np.count_nonzero, masks)) < period:
            return None
        segmenter = _Segmenter.fit(values, best.phases, masks, tempos, period)
        values = [
            _normalised(y, segmenter.cycle.values(phase), mask, size)
            for y, phase, mask in zip(recordings, best.phases, masks, strict=True)
        ]
        tempos = [
            _tempo(phase, mask, size)
            for phase, mask in zip(best.phases, masks, strict=True)
        ]
        # On a line both directions fit equally well, and the longer one may change.
        before, best = best, segmenter.segment(values, tempos).in_longer_direction()
        if all(map(np.array_equal, before.labels, best.labels)):
            break
    return best


def segments(recordings: Sequence[Array], masks: Sequence[Mask]) -> list[Array]:
    """Return the segments of recordings where masks are true."""
    return [
        y[a:b] for y, mask in zip(recordings, masks, strict=True) for a, b in runs(mask)
    ]


class _Segmenter(NamedTuple):
    """A cycle, and the deviations of positions and velocities from it."""

    cycle: Cycle
    deviations: Sequence[float]
    period: float

    @classmethod
    def fit(
        cls,
        values: Sequence[Array],
        phases: Sequence[Array],
        masks: Sequence[Mask],
        tempos: Sequence[Array],
        period: float,
    ) -> "_Segmenter":
        """Fit a cycle and deviations to the samples of values (n, D) in masks (n,)."""
        step, velocity = _step(period), 2 * np.pi / period
        states = [
            np.hstack(_states(v, velocity * tempo[:, None], step))[mask]
            for v, tempo, mask in zip(values, tempos, masks, strict=True)
        ]
        points, rates = np.split(np.concatenate(states), 2, axis=1)
        angles = np.concatenate([p[m] for p, m in zip(phases, masks, strict=True)])
        harmonics = harmonics_of(period, _HARMONICS)
        cycle = Cycle.fit([angles], [points], harmonics=harmonics)
        nodes = _cycle_states(cycle, angles, step * velocity)
        errors = [
            np.sqrt(
                np.mean(np.sum((x - n) ** 2, axis=1))
                / max(n.var(axis=0).sum(), _LEAST_VARIANCE)
            )
            for x, n in zip((points, rates), nodes, strict=True)
        ]
        return cls(cycle, np.clip(errors, _LEAST_DEVIATIONS, _FIRST_DEVIATIONS), period)

    def segment(self, values: Sequence[Array], tempos: Sequence[Array]) -> Segmentation:
        """Return the cheapest segmentation of values (n, D) at tempos (n,).

        The reversed cycle is a second cycle, on which the phase increases, too.
        """
        step, velocity = _step(self.period), 2 * np.pi / self.period
        grid = phase_states(self.period)
        count = len(grid)
        increments = np.arange(int(FASTEST * count / self.period) + 1)
        nodes = np.hstack(_cycle_states(self.cycle, grid, step * velocity))
        d = nodes.shape[1] // 2
        variances = nodes.var(axis=0).reshape(2, d).sum(axis=1)
        variances = np.maximum(variances, _LEAST_VARIANCE)
        scales = np.repeat(self.deviations * np.sqrt(variances), d)
        directions = [nodes / scales, nodes[::-1] * np.repeat([1, -1], d) / scales]
        mean_square = max(np.mean(np.sum(nodes[:, d:] ** 2, axis=1)), _LEAST_VARIANCE)
        labels, phases, total = [], [], 0.0
        for v, tempo in zip(values, tempos, strict=True):
            states = np.hstack(_states(v, velocity * tempo[:, None], step))
            costs = np.empty((2, len(v), count))
            for out, directed in zip(costs, directions, strict=True):
                _squared_distances(states / scales, directed, out)
            speeds = np.sum(states[:, d:] ** 2, axis=1) / mean_square
            outside = _OUTSIDE * np.minimum(speeds / _REST_SPEED**2, 1.0)
            tempo_ratios = increments * self.period / count / tempo[:, None]
            step_costs = ((tempo_ratios - 1) / _VELOCITY_SPREAD) ** 2
            label, index, cost = best_labels(
                costs, step_costs, outside, _CHANGE * _OUTSIDE * self.period
            )
            labels.append(label)
            phases.append(grid[index])
            total += cost
        return Segmentation(labels, phases, total)


def _step(period: float) -> int:
    """Return half the interval of a difference quotient, samples."""
    return max(1, round(period / _STEPS_PER_PERIOD))


def _moving_mean(values: Array, mask: Mask, size: int) -> Array:
    """Return the mean of the values (n, D) in a mask (n,) over windows of a size.

    The windows are inside the runs of the mask; elsewhere the means are interpolated.
    """
    inside = np.flatnonzero(mask)
    if not len(inside):
        return np.repeat(values.mean(axis=0, keepdims=True), len(values), axis=0)
    means = np.zeros_like(values)
    for a, b in runs(mask):
        width = min(size, b - a)
        run = _window_sums(values[a:b], width) / width
        centres = np.clip(np.arange(b - a) - width // 2, 0, len(run) - 1)
        # Twice, since windows of a cycle that lasts longer or shorter have another mean.
        means[a:b] = uniform_filter1d(run[centres], width, axis=0, mode="nearest")
    times = np.arange(len(values))
    return np.column_stack([np.interp(times, inside, m[inside]) for m in means.T])


def _window_sums(values: Array, size: int) -> Array:
    """Return the sums of values (n, ...) in windows, shape (n - size + 1, ...)."""
    sums = np.zeros((len(values) + 1, *values.shape[1:]))
    np.cumsum(values, axis=0, out=sums[1:])
    return sums[size:] - sums[:-size]


def _normalised(values: Array, fit: Array, mask: Mask, size: int) -> Array:
    """Return values (n, D) relative to a moving centre and size.

    Centre and size are chosen so that `fit` (n, D), the values of a cycle at the phases of
    the samples, is as near as possible. Where `fit` is 0, they are the mean and the standard
    deviation.
    """
    d = values.shape[1]
    products = (
        values,
        fit,
        np.vecdot(values, fit)[:, None],
        np.vecdot(fit, fit)[:, None],
        np.vecdot(values, values)[:, None],
    )
    means = _moving_mean(np.hstack(products), mask, size)
    value, cycle = means[:, :d], means[:, d : 2 * d]
    product, square, energy = means[:, 2 * d :].T
    if fit.any():
        scale = (product - np.vecdot(value, cycle)) / np.maximum(
            square - np.vecdot(cycle, cycle), 1e-300
        )
    else:
        scale = np.sqrt(np.maximum(energy - np.vecdot(value, value), 1e-300))
    # Where no size fits at all, the values keep theirs.
    least = 1e-3 * float(np.max(np.abs(scale))) or 1.0
    scale = np.maximum(scale, least)[:, None]
    return (values - value + scale * cycle) / scale


def _tempo(phases: Array, mask: Mask, size: int) -> Array:
    """Return the moving phase velocity of phases (n,), relative to that of the period."""
    change = np.diff(phases, prepend=phases[:1])
    change = np.mod(change + np.pi, 2 * np.pi) - np.pi
    is_inside = mask & np.concatenate([[False], mask[:-1]])
    tempo = _moving_mean(change[:, None], is_inside, size)[:, 0]
    return np.clip(tempo * size / (2 * np.pi), *_TEMPOS)


def _states(values: Array, velocity: Array, step: int) -> tuple[Array, Array]:
    """Return values (n, D) and their difference quotients by phase; velocity (n, 1)."""
    times = np.arange(len(values))
    before = np.maximum(times - step, 0)
    after = np.minimum(times + step, len(values) - 1)
    span = np.maximum(after - before, 1)[:, None]
    return values, (values[after] - values[before]) / (span * velocity)


def _cycle_states(cycle: Cycle, phase: Array, half: float) -> tuple[Array, Array]:
    """Return values of a cycle and their difference quotients over phases (n,) +- half."""
    difference = cycle.values(phase + half) - cycle.values(phase - half)
    return cycle.values(phase), difference / (2 * half)


def _squared_distances(samples: Array, nodes: Array, out: Array) -> None:
    """Compute the squared distances (n, S) of samples (n, D) to nodes (S, D)."""
    rows = [samples, np.ones((len(samples), 1)), np.vecdot(samples, samples)[:, None]]
    columns = [-2 * nodes, np.vecdot(nodes, nodes)[:, None], np.ones((len(nodes), 1))]
    np.matmul(np.hstack(rows), np.hstack(columns).T, out=out)
