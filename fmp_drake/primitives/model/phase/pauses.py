"""Recordings without pauses that are not a part of each cycle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from fmp_drake.numeric import Array, Indices, rms, runs
from fmp_drake.primitives.model.phase.rhythm import Part

# Least length of a pause, samples, its speed relative to the root mean square, and samples
# over which the velocity is averaged.
_LEAST, _SPEED, _SMOOTHED = 12, 0.1, 7
# Distances relative to the size of the movement: of pauses at the same place, and of a lift
# from the movement.
_SAME_PLACE, _LIFTED = 0.3, 0.2
# Samples before and after two pauses that are compared, the longest ways up and down that are
# tried in this order, and the longest time from a movement to a pause.
_BESIDE, _WAYS, _SLOW = 8, (30, 60), 12
# Least step beside a pause, relative to the median.
_STEP = 0.7
# Labels of samples.
_KEPT, _SLOW_SAMPLE, _PAUSE, _LIFT = range(4)


class _Rest(NamedTuple):
    """Interval, in samples, in which a path (n, D) rests, or is lifted."""

    path: Array
    start: int
    end: int
    is_lift: bool = False

    @property
    def is_inner(self) -> bool:
        """Whether it is not at an end of the recording."""
        return 0 < self.start and self.end < len(self.path)

    def is_like(self, other: "_Rest", near: float) -> bool:
        """Return whether place, arrival and departure are near those of another one."""
        pairs = [[y[a:b].mean(axis=0) for y, a, b, _ in (self, other)]]
        if self.start and other.start:
            pairs.append([y[max(a - _BESIDE, 0)] for y, a, _, _ in (self, other)])
        if self.end < len(self.path) and other.end < len(other.path):
            pairs.append([y[: b + _BESIDE][-1] for y, _, b, _ in (self, other)])
        return all(np.linalg.norm(one - two) < near for one, two in pairs)

    def lift(self, size: float) -> "_Rest":
        """Return the lift with this rest at its top, or the rest where there is none.

        Up and down lead the same way, to a place away from all other samples. `size` is that
        of the movement.
        """
        path, start, end, _ = self
        for way in _WAYS:
            first, stop = max(start - way, 0), min(end + way, len(path))
            others = np.concatenate([path[:first], path[stop:]])
            if not len(others):
                break
            distances, _ = KDTree(others).query(path[first:stop])
            height = float(distances[start - first : end - first].min())
            if height < _LIFTED * size:
                break
            near = first + np.flatnonzero(distances < height / 2)
            before, after = near[near < start], near[near >= end]
            # Samples at the ends of both ways are near those beside them.
            if not (np.any(before > first + _SLOW) and np.any(after < stop - _SLOW)):
                continue
            a, b = int(before[-1]), int(after[0])
            gaps, _ = KDTree(path[a:start]).query(path[end : b + 1])
            if gaps.max() < height / 2:
                # The movement stops where the lift begins and ends.
                speed = np.linalg.norm(np.gradient(path, axis=0), axis=1)
                slow = max(a - _SLOW, 0)
                a = slow + int(np.argmin(speed[slow : a + 1]))
                b += int(np.argmin(speed[b : b + _SLOW]))
                return self._replace(start=a, end=b, is_lift=True)
        return self

    def mark(self, labels: Indices, least: float) -> None:
        """Mark it in labels (n,), and samples beside it, so that no step is below the least."""
        labels[self.start : self.end] = _LIFT if self.is_lift else _PAUSE
        last = max(self.start - _SLOW, 0)
        for i in range(last + 1, min(self.end + _SLOW, len(self.path))):
            if labels[i] == _KEPT:
                if np.linalg.norm(self.path[i] - self.path[last]) < least:
                    labels[i] = _SLOW_SAMPLE
                else:
                    last = i


@dataclass(frozen=True, kw_only=True, eq=False)
class WithoutPauses:
    """Recordings as if the movement went on without pauses.

    Attributes
    ----------
    values : list of ndarray, shape (m, D)
        Samples that are kept.
    labels : list of ndarray, shape (n,)
        Of all samples of the recordings: kept, left out beside a pause, or in a pause or lift.
    """

    values: list[Array]
    labels: list[Indices]

    def parts(self, parts: Sequence[Part], rate: float) -> list[Part]:
        """Convert parts of `values` to parts of the recordings, and add the pauses."""
        out = []
        for number, label in enumerate(self.labels):
            kept, is_cut = np.flatnonzero(label == _KEPT), label >= _PAUSE
            here = [part for part in parts if part.recording == number]
            here.sort(key=lambda part: part.start)
            owner = np.zeros(len(label), dtype=int)
            for i, part in enumerate(here[1:], 1):
                owner[kept[round(part.start * rate)] :] = i
            owner[is_cut] = -1
            edges = np.flatnonzero(np.diff(owner)) + 1
            for a, b in pairwise([0, *edges.tolist(), len(label)]):
                start, end = a / rate, b / rate
                if is_cut[a]:
                    kind = "lift" if np.any(label[a:b] == _LIFT) else "pause"
                    part = Part(recording=number, start=start, end=end, kind=kind)
                else:
                    part = here[owner[a]]
                    steps = np.array(part.cycle_ends) * rate
                    whole = np.minimum(steps.astype(int), len(kept) - 1)
                    ends = (kept[whole] + steps - whole) / rate
                    ends = ends[(start < ends) & (ends <= end)]
                    cycle_ends = tuple(ends.tolist())
                    part = replace(part, start=start, end=end, cycle_ends=cycle_ends)
                out.append(part)
        return out


def without_pauses(
    recordings: Sequence[Array], columns: list[int]
) -> list[WithoutPauses]:
    """Cut the pauses out of recordings (n, D).

    There are two results where pauses seem to be at the top of lifts: without these lifts, and
    without the pauses alone. There is none where a recording rests twice at the same place, at
    its ends or between, since it may do so in each cycle. Rest at the ends stays. Speeds and
    distances are measured in `columns`.
    """
    paths = [y[:, columns] for y in recordings]
    size = float(np.sqrt(np.concatenate(paths).var(axis=0).sum()))
    rests = [[_Rest(y, a, b) for a, b in _rests(y)] for y in paths]
    pauses = [[rest for rest in found if rest.is_inner] for found in rests]
    if not any(pauses) or any(
        one.is_like(other, _SAME_PLACE * size)
        for found in rests
        for one, other in combinations(found, 2)
        if one.is_inner or other.is_inner
    ):
        return []
    lifts = [[pause.lift(size) for pause in found] for found in pauses]
    has_lifts = any(rest.is_lift for found in lifts for rest in found)
    steps = [np.linalg.norm(np.diff(y, axis=0), axis=1) for y in paths]
    least_steps = [_STEP * float(np.median(step)) for step in steps]
    out = []
    for cuts in [lifts, pauses] if has_lifts else [pauses]:
        labels = [np.full(len(y), _KEPT) for y in recordings]
        for label, found, least in zip(labels, cuts, least_steps, strict=True):
            for rest in found:
                rest.mark(label, least)
        values = [
            y[label == _KEPT] for y, label in zip(recordings, labels, strict=True)
        ]
        out.append(WithoutPauses(values=values, labels=labels))
    return out


def _rests(path: Array) -> list[tuple[int, int]]:
    """Return start and end of the intervals in which a path (n, D) rests."""
    velocity = uniform_filter1d(np.gradient(path, axis=0), _SMOOTHED, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    is_slow = speed < _SPEED * rms(speed)
    return [(a, b) for a, b in runs(is_slow) if b - a >= _LEAST]
