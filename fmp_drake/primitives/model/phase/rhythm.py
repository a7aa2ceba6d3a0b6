"""Segmentation of recordings into rhythmic bouts and other parts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.model.phase.cycle import Cycle
from fmp_drake.primitives.model.phase.period import SIMILAR, similarity

# Speed at rest relative to its root mean square. A rest is longer by the factor than the
# median where each cycle contains one.
_REST_SPEED, _REST_FACTOR = 0.08, 1.7
# Lags, in periods, at which neighbouring cycles are compared.
_LAGS = (0.8, 0.9, 1.0, 1.12, 1.25)
# Limit of the distance to another cycle: bounds in sizes of the movement, and factor of the
# quantile over samples of similar cycles.
_TUBE_BOUNDS, _TUBE_FACTOR, _TUBE_QUANTILE = (0.12, 0.5), 2.0, 0.9
# Least standard deviation from the cycle that is assumed, in sizes of the movement.
_LEAST_DEVIATION = 0.03
# Limit of the distance from the cycle: quantile and factor. A part is left out where its
# distance exceeds the limit by a further factor.
_LIMIT_QUANTILE, _LIMIT_FACTOR, _EXIT_FACTOR = 0.9, 1.5, 2.0
# Phase velocities at rest and nearly at rest, relative to the mean. They are not evaluated
# where the squared velocity of the cycle, relative to its mean, is below the last value.
_REST_VELOCITY, _SLOW_VELOCITY, _LEAST_SQUARED_VELOCITY = 0.3, 0.6, 0.1
# Shortest bout, gap, rest and part that is left out, in periods.
_LEAST_BOUT, _LEAST_GAP, _LEAST_REST, _LEAST_PART = 0.6, 0.15, 0.12, 0.07
# Squared distance of states from the cycle, relative to its variance, in another movement.
# In reversed motion, squared distance of the reversed states relative to that of the states.
_OTHER_DISTANCE, _REVERSE_RATIO = 0.3, 0.4
# Sizes of a cycle, relative to the mean one, that are the same movement.
_SCALES = (0.6, 1.7)
_PHASES = 400
# Fraction of the recorded time that is left out, above which a remark is made.
_LARGE_FRACTION = 0.2
# Least relative change from the first to the last cycle that is reported, also in standard
# errors.
_LEAST_CHANGE, _STANDARD_ERRORS = 0.25, 3.0
# Least drift that is reported.
_LEAST_DRIFT = 0.1


@dataclass(frozen=True, kw_only=True)
class Part:
    """Interval of a recording.

    Attributes
    ----------
    recording : int
        Index of the recording.
    start, end : float
        s, from the beginning of the recording.
    kind : str
        "bout", or the reason for leaving it out: "approach", "retreat", "pause", "lift"
        (a departure from the movement and return), "backwards" or "another movement".
    """

    recording: int
    start: float
    end: float
    kind: str

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.end - self.start


@dataclass(frozen=True, kw_only=True)
class Rhythm:
    """Period, cycles, bouts and omitted parts of recordings.

    Attributes
    ----------
    period : float
        Mean duration of a cycle, s.
    cycles : float
        Number of cycles in all bouts.
    bouts, left_out : tuple of Part
        Parts that are learned from, and omitted parts.
    amplitude_change, tempo_change : float
        Change along the recordings relative to the mean, from a linear fit; 0 where it is
        not significant.
    drift : float
        Displacement of the centre along the recordings, relative to the width.
    irregular : tuple of str
        Channels that do not repeat; the phase is that of the other channels.

    Examples
    --------
    >>> bout = Part(recording=0, start=2.0, end=10.0, kind="bout")
    >>> approach = Part(recording=0, start=0.0, end=2.0, kind="approach")
    >>> rhythm = Rhythm(period=2.0, cycles=4.0, bouts=(bout,), left_out=(approach,))
    >>> for line in rhythm.describe():
    ...     print(line)
    4.0 cycles of 2.00 s
    left out: approach, 0.0 to 2.0 s
    """

    period: float
    cycles: float
    bouts: tuple[Part, ...]
    left_out: tuple[Part, ...] = ()
    amplitude_change: float = 0.0
    tempo_change: float = 0.0
    drift: float = 0.0
    irregular: tuple[str, ...] = ()

    @property
    def fraction_left_out(self) -> float:
        """Fraction of the recorded time that is left out."""
        omitted = sum(part.duration for part in self.left_out)
        return omitted / (omitted + sum(part.duration for part in self.bouts))

    def shifted(self, seconds: float) -> "Rhythm":
        """Return the rhythm of recordings that begin later by some seconds."""

        def shift(part: Part) -> Part:
            return replace(part, start=part.start + seconds, end=part.end + seconds)

        return replace(
            self,
            bouts=tuple(map(shift, self.bouts)),
            left_out=tuple(map(shift, self.left_out)),
        )

    def describe(self) -> list[str]:
        """Return lines about cycles and omitted parts, and remarks."""
        bouts = f" in {len(self.bouts)} bouts" if len(self.bouts) > 1 else ""
        lines = [f"{self.cycles:.1f} cycles of {self.period:.2f} s{bouts}"]
        recordings = {part.recording for part in (*self.bouts, *self.left_out)}
        parts = [
            f"{part.kind}, {part.start:.1f} to {part.end:.1f} s"
            + f" of recording {part.recording + 1}" * (len(recordings) > 1)
            for part in self.left_out
        ]
        if parts:
            lines.append(f"left out: {'; '.join(parts)}")
        return lines + self.remarks()

    def remarks(self) -> list[str]:
        """Return remarks on unusual recordings."""
        out = []
        if self.irregular:
            out.append(
                "the cycles are those of the other channels: not in every cycle the same "
                f"are {', '.join(self.irregular)}"
            )
        kinds = {part.kind for part in self.left_out}
        if "backwards" in kinds:
            out.append(
                "the direction reverses: the part in the direction of fewer cycles is left "
                "out; record one direction, or choose a part (from, to)"
            )
        if "another movement" in kinds:
            out.append(
                "there are two movements: the one of fewer cycles is left out; learn a skill "
                "of each (from, to)"
            )
        if self.fraction_left_out > _LARGE_FRACTION:
            out.append(
                f"{100 * self.fraction_left_out:.0f} % of the recording is left out"
            )
        for what, change in (
            ("amplitude", self.amplitude_change),
            ("tempo", self.tempo_change),
        ):
            if change:
                grows = "grows" if change > 0 else "falls"
                out.append(
                    f"the {what} {grows} by {100 * abs(change):.0f} % of its mean: the skill "
                    "is about the middle, and its samples vary as much"
                )
        if self.drift > _LEAST_DRIFT:
            out.append(
                f"the centre drifts by {100 * self.drift:.0f} % of the width: the skill is "
                "played about the middle, and its samples are wider than one cycle"
            )
        return out


def trend(values: Array) -> float:
    """Return the change of positive values (n,) along a line, relative to their mean.

    It is 0 if it is small or not significant.
    """
    count = len(values)
    if count < 4:
        return 0.0
    offsets = np.arange(count) - (count - 1) / 2
    slope = float(offsets @ values) / float(offsets @ offsets)
    errors = values - values.mean() - slope * offsets
    deviation = np.sqrt(float(errors @ errors) / (count - 2) / float(offsets @ offsets))
    change = slope * (count - 1) / float(values.mean())
    is_significant = abs(slope) > _STANDARD_ERRORS * deviation
    return change if is_significant and abs(change) > _LEAST_CHANGE else 0.0


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return start and end of the runs of true values in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def recurrent_samples(recordings: Sequence[Array], period: float) -> list[Mask]:
    """Return masks (n,) of the samples of recordings (n, D) that recur in another cycle.

    Positions and velocities are compared. The limit of their distance follows from the
    samples in two similar neighbouring cycles.
    """
    rests = [_rests(y, period) for y in recordings]
    cores = [
        _similar_cycles(y, period) & ~rest
        for y, rest in zip(recordings, rests, strict=True)
    ]
    if not any(core.any() for core in cores):
        cores = [~rest for rest in rests]
    core_values = np.concatenate([y[c] for y, c in zip(recordings, cores, strict=True)])
    size = float(np.sqrt(core_values.var(axis=0).sum()))
    states = [_states(y, 2 * np.pi / period) for y in recordings]
    trees = [
        KDTree(s[~r]) if not r.all() else None
        for s, r in zip(states, rests, strict=True)
    ]
    distances = []
    for i, state in enumerate(states):
        nearest = np.full(len(state), np.inf)
        for j, tree in enumerate(trees):
            if tree is not None and i != j:
                nearest = np.minimum(nearest, tree.query(state)[0])
        distances.append(np.minimum(nearest, _cycle_distance(state, rests[i], period)))
    typical_distance = np.quantile(
        np.concatenate([d[c] for d, c in zip(distances, cores, strict=True)]),
        _TUBE_QUANTILE,
    )
    limit = float(
        np.clip(
            _TUBE_FACTOR * typical_distance,
            _TUBE_BOUNDS[0] * size,
            _TUBE_BOUNDS[1] * size,
        )
    )
    out = []
    for distance, rest in zip(distances, rests, strict=True):
        mask = (distance <= limit) & ~rest
        gap = max(3.0, _LEAST_GAP * period)
        for a, b in runs(~mask):
            if b - a <= gap and not rest[a:b].all():
                mask[a:b] = True
        out.append(without_short(mask, _LEAST_BOUT * period))
    return out


def cyclic_samples(
    recordings: Sequence[Array], masks: Sequence[Mask], cycle: Cycle, velocity: float
) -> list[Mask]:
    """Return masks (n,) of the samples of recordings (n, D) that follow a cycle.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    masks : sequence of ndarray, shape (n,)
        Samples that the cycle was learned from.
    cycle : Cycle
    velocity : float
        Mean phase velocity, rad per sample.
    """
    grid = 2 * np.pi * np.arange(_PHASES) / _PHASES
    points, tangents = cycle.values(grid), cycle.values(grid, 1)
    tree = KDTree(np.hstack([points, tangents]))
    errors, speeds = [], []
    square = np.sum(tangents**2, axis=1)
    for y in recordings:
        state = _states(y, velocity)
        nearest = tree.query(state)[1]
        tangent, squared = tangents[nearest], square[nearest, None]
        error = y - points[nearest]
        # The error along the cycle is a phase error.
        projection = np.sum(error * tangent, axis=1, keepdims=True)
        errors.append(
            error
            - tangent * projection / (squared + _LEAST_SQUARED_VELOCITY * square.mean())
        )
        speed = np.sum(state[:, y.shape[1] :] * tangents[nearest], axis=1)
        is_too_slow = square[nearest] < _LEAST_SQUARED_VELOCITY * square.mean()
        speeds.append(
            np.where(is_too_slow, 1.0, speed / np.maximum(square[nearest], 1e-300))
        )
    inner = np.concatenate([e[m] for e, m in zip(errors, masks, strict=True)])
    inner = inner[
        np.argsort(np.sum(inner**2, axis=1))[: max(4, round(0.9 * len(inner)))]
    ]
    d = inner.shape[1]
    covariance = inner.T @ inner / len(inner)
    covariance += _LEAST_DEVIATION**2 * float(points.var(axis=0).sum()) * np.eye(d)
    root = np.linalg.cholesky(np.linalg.inv(covariance))
    distances = [np.linalg.norm(e @ root, axis=1) / np.sqrt(d) for e in errors]
    core_distances = np.concatenate(
        [x[m] for x, m in zip(distances, masks, strict=True)]
    )
    limit = max(
        1.0, _LIMIT_FACTOR * float(np.quantile(core_distances, _LIMIT_QUANTILE))
    )
    period = 2 * np.pi / velocity
    out = []
    for y, distance, speed in zip(recordings, distances, speeds, strict=True):
        is_at_rest = (speed < _REST_VELOCITY) | _rests(y, period)
        is_outside = (distance > limit) | is_at_rest
        is_joined = is_outside.copy()
        for a, b in runs(~is_outside):
            if b - a <= _LEAST_PART * period:
                is_joined[a:b] = True
        mask = np.ones(len(is_outside), dtype=bool)
        for a, b in runs(is_joined):
            if b - a <= max(2.0, _LEAST_PART * period):
                continue
            longest = max((e - s for s, e in runs(is_at_rest[a:b])), default=0)
            if distance[a:b].max() > _EXIT_FACTOR * limit or longest >= max(
                5.0, _LEAST_REST * period
            ):
                mask[slice(*_extended(speed, a, b, _LEAST_GAP * period))] = False
        out.append(without_short(mask, _LEAST_BOUT * period))
    return out


def other_samples(
    recordings: Sequence[Array], cycle: Cycle, period: float
) -> list[tuple[Mask, Mask]]:
    """Return masks (n,) of reversed motion and of another movement, for each recording.

    Slow displacements of the centre are ignored.
    """
    grid = 2 * np.pi * np.arange(_PHASES) / _PHASES
    points, tangents = cycle.values(grid), cycle.values(grid, 1)
    points = points - points.mean(axis=0)
    tree = KDTree(np.hstack([points, tangents]))
    variance = float(points.var(axis=0).sum() + tangents.var(axis=0).sum())
    size = max(3, round(period))
    out = []
    for y in recordings:
        d = y.shape[1]
        centred = y - uniform_filter1d(y, size, axis=0)
        extent = uniform_filter1d(np.sum(centred**2, axis=1), size)
        scale = np.sqrt(np.maximum(extent, 1e-300) / points.var(axis=0).sum())
        centred = centred / np.clip(scale, *_SCALES)[:, None]
        state = _states(centred, 2 * np.pi / period)
        forwards, backwards = (
            uniform_filter1d(tree.query(state * np.repeat([1, sign], d))[0] ** 2, size)
            for sign in (1, -1)
        )
        reverse = backwards < _REVERSE_RATIO * forwards
        is_far = np.minimum(forwards, backwards) > _OTHER_DISTANCE * variance
        out.append((reverse, ~reverse & is_far))
    return out


def without_short(mask: Mask, least: float) -> Mask:
    """Return a mask without its runs of fewer than `least` true values."""
    out = mask.copy()
    for a, b in runs(mask):
        if b - a < least:
            out[a:b] = False
    return out


def without_ends(mask: Mask, aligned: Mask, least: float) -> Mask:
    """Return a mask without short extensions of its runs beyond aligned samples.

    An extension of fewer than `least` samples that does not reach the end of the recording
    may be a part of an approach or retreat that is near the cycle.
    """
    out = mask.copy()
    for a, b in runs(mask):
        inside = a + np.flatnonzero(aligned[a:b])
        if len(inside) and a > 0 and inside[0] - a < least:
            out[a : inside[0]] = False
        if len(inside) and b < len(mask) and b - 1 - inside[-1] < least:
            out[inside[-1] + 1 : b] = False
    return out


def _extended(speed: Array, start: int, end: int, most: float) -> tuple[int, int]:
    """Extend a run to nearby minima of the phase velocity (n,) with small values."""
    before = max(0, start - round(most))
    after = min(len(speed), end + round(most))
    if start > 0 and speed[before : start + 1].min() < _SLOW_VELOCITY:
        start = before + int(np.argmin(speed[before : start + 1]))
    if end < len(speed) and speed[end - 1 : after].min() < _SLOW_VELOCITY:
        end = end + int(np.argmin(speed[end - 1 : after]))
    return start, end


def _states(values: Array, velocity: float) -> Array:
    """Return values (n, D) and their derivatives by the nominal phase, (n, 2 D)."""
    smooth = uniform_filter1d(values, 3, axis=0) if len(values) > 3 else values
    return np.hstack([values, np.gradient(smooth, axis=0) / velocity])


def _rests(values: Array, period: float) -> Mask:
    """Return a mask (n,) of the rests of a recording (n, D), except those in each cycle."""
    velocity = np.gradient(uniform_filter1d(values, 3, axis=0), axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    least = max(5.0, 0.1 * period)
    rests = [
        (a, b)
        for a, b in runs(speed < _REST_SPEED * np.sqrt(np.mean(speed**2)))
        if b - a >= least
    ]
    if len(rests) >= max(3, 0.6 * len(values) / period):
        typical_length = float(np.median([b - a for a, b in rests]))
        rests = [(a, b) for a, b in rests if b - a >= _REST_FACTOR * typical_length]
    out = np.zeros(len(values), dtype=bool)
    for a, b in rests:
        out[a:b] = True
    return out


def _similar_cycles(values: Array, period: float) -> Mask:
    """Return a mask (n,) of the samples in two similar neighbouring cycles."""
    out = np.zeros(len(values), dtype=bool)
    for ratio in _LAGS:
        lag = round(ratio * period)
        for start in np.flatnonzero(similarity(values, lag, lag) > SIMILAR):
            out[start : start + 2 * lag] = True
    return out


def _cycle_distance(states: Array, rests: Mask, period: float) -> Array:
    """Return the distance (n,) of each state to others at least half a period away."""
    moving = np.flatnonzero(~rests)
    out = np.full(len(states), np.inf)
    if len(moving):
        states = states - states[moving].mean(axis=0)
        moving_states = states[moving]
        squares = np.sum(moving_states**2, axis=1)
        for first in range(0, len(states), 100):
            rows = np.arange(first, min(first + 100, len(states)))
            distance = squares - 2 * states[rows] @ moving_states.T
            starts = np.searchsorted(moving, rows - 0.5 * period, side="right")
            ends = np.searchsorted(moving, rows + 0.5 * period)
            for row, begin, end in zip(distance, starts, ends, strict=True):
                row[begin:end] = np.inf
            out[rows] = distance.min(axis=1) + np.sum(states[rows] ** 2, axis=1)
    return np.sqrt(np.maximum(out, 0.0))
