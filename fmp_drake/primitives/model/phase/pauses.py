"""Recordings without pauses that are not a part of each cycle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from fmp_drake.numeric import Array, Indices, Mask, runs
from fmp_drake.primitives.model.phase.rhythm import Part

# Least length of a pause, samples, its speed relative to the root mean square, and samples
# over which the speed is averaged.
_LEAST, _SPEED, _SMOOTHED = 10, 0.1, 5
# Distances relative to the size of the movement: of pauses at the same place, and of a lift
# from the movement.
_SAME_PLACE, _LIFTED = 0.3, 0.2
# Samples before and after two pauses that are compared, the longest ways up and down that are
# tried in this order, and the longest time from a movement to a pause.
_BESIDE, _WAYS, _SLOW = 8, (30, 60), 12
# Least step beside a pause, relative to the median.
_STEP = 0.7


class _Rest(NamedTuple):
    """Interval, in samples, in which the path (n, D) of a recording rests, or is lifted.

    `number` is the index of the recording, `kind` that of `Part`.
    """

    number: int
    path: Array
    start: int
    end: int
    kind: str = "pause"

    @property
    def is_inner(self) -> bool:
        """Whether it is not at an end of the recording."""
        return 0 < self.start and self.end < len(self.path)

    def is_like(self, other: "_Rest", near: float) -> bool:
        """Return whether place, arrival and departure are near those of another one."""
        pairs = [[y[a:b].mean(axis=0) for _, y, a, b, _ in (self, other)]]
        if self.start and other.start:
            pairs.append([y[max(a - _BESIDE, 0)] for _, y, a, _, _ in (self, other)])
        if self.end < len(self.path) and other.end < len(other.path):
            pairs.append([y[: b + _BESIDE][-1] for _, y, _, b, _ in (self, other)])
        return all(np.linalg.norm(one - two) < near for one, two in pairs)

    def lift(self, size: float) -> "_Rest":
        """Return the lift with this rest at its top, or the rest where there is none.

        Up and down lead the same way, to a place away from all other samples. `size` is that
        of the movement.
        """
        _, path, start, end, _ = self
        for way in _WAYS:
            first, stop = max(start - way, 0), min(end + way, len(path))
            others = np.concatenate([path[:first], path[stop:]])
            if not len(others):
                break
            distances, _ = KDTree(others).query(path[first:stop])
            height = float(distances[start - first : end - first].min())
            if height < _LIFTED * size:
                break
            before, after = (
                offset + np.flatnonzero(d < height / 2)
                for offset, d in (
                    (first, distances[: start - first]),
                    (end, distances[end - first :]),
                )
            )
            # Samples at the ends of both ways are near those beside them.
            if not (np.any(before > first + _SLOW) and np.any(after < stop - _SLOW)):
                continue
            a, b = int(before[-1]), int(after[0])
            gaps, _ = KDTree(path[a:start]).query(path[end : b + 1])
            if gaps.max() < height / 2:
                # The movement stops where the lift begins and ends.
                speed = _speed(path)
                slow = max(a - _SLOW, 0)
                a = slow + int(np.argmin(speed[slow : a + 1]))
                b += int(np.argmin(speed[b : b + _SLOW]))
                return self._replace(start=a, end=b, kind="lift")
        return self

    def cut(self, is_kept: Mask) -> None:
        """Clear it in a mask (n,), and as many samples beside it as make the path slow."""
        least = _STEP * float(
            np.median(np.linalg.norm(np.diff(self.path, axis=0), axis=1))
        )
        is_kept[self.start : self.end] = False
        last = max(self.start - _SLOW, 0)
        for i in range(last + 1, min(self.end + _SLOW, len(self.path))):
            if is_kept[i]:
                is_kept[i] = np.linalg.norm(self.path[i] - self.path[last]) >= least
                last = i if is_kept[i] else last


@dataclass(frozen=True, kw_only=True, eq=False)
class Continued:
    """Recordings as if the movement went on without pauses.

    Attributes
    ----------
    values : list of ndarray, shape (m, D)
        Samples that are kept.
    kept : list of ndarray, shape (m,)
        Their indices in the recordings.
    pauses : list of Part
        Pauses, and lifts with a pause at their top, that are cut out.
    """

    values: list[Array]
    kept: list[Indices]
    pauses: list[Part]

    def parts(self, parts: Sequence[Part], rate: float) -> list[Part]:
        """Convert parts of `values` to parts of the recordings, and add the pauses."""
        out = list(self.pauses)
        for part in parts:
            kept = self.kept[part.recording]
            first, last = round(part.start * rate), round(part.end * rate) - 1
            is_inside = np.zeros(int(kept[last]) + 1, dtype=bool)
            is_inside[kept[first] :] = True
            for pause in self.pauses:
                if pause.recording == part.recording:
                    is_inside[round(pause.start * rate) : round(pause.end * rate)] = (
                        False
                    )
            steps = np.array(part.cycle_ends) * rate
            cycle_ends = np.interp(steps, np.arange(len(kept)), kept) / rate
            for a, b in runs(is_inside):
                start, end = a / rate, b / rate
                is_here = (start <= cycle_ends) & (cycle_ends < end)
                out.append(
                    replace(
                        part,
                        start=start,
                        end=end,
                        cycle_ends=tuple(cycle_ends[is_here].tolist()),
                    )
                )
        return out


def without_pauses(
    recordings: Sequence[Array], columns: list[int], rate: float
) -> list[Continued]:
    """Cut the pauses out of recordings (n, D).

    There are two results where pauses seem to be at the top of lifts: without these lifts, and
    without the pauses alone. There is none where a pause comes again at the same place, since
    it may be a part of each cycle. Rest at the beginning and end of a recording stays. Speeds
    and distances are measured in `columns`.
    """
    paths = [y[:, columns] for y in recordings]
    size = float(np.sqrt(np.concatenate(paths).var(axis=0).sum()))
    rests = [_Rest(i, y, a, b) for i, y in enumerate(paths) for a, b in _rests(y)]
    pauses = [rest for rest in rests if rest.is_inner]
    if any(
        one.is_like(other, _SAME_PLACE * size)
        for one, other in combinations(rests, 2)
        if one.is_inner or other.is_inner
    ):
        return []
    lifts = [pause.lift(size) for pause in pauses]
    has_lifts = any(lift.kind == "lift" for lift in lifts)
    out = []
    for cuts in [lifts] * has_lifts + [pauses] * bool(pauses):
        masks = [np.ones(len(y), dtype=bool) for y in recordings]
        for cut in cuts:
            cut.cut(masks[cut.number])
        values = [y[mask] for y, mask in zip(recordings, masks, strict=True)]
        parts = [
            Part(recording=i, start=a / rate, end=b / rate, kind=kind)
            for i, _, a, b, kind in cuts
        ]
        kept = list(map(np.flatnonzero, masks))
        out.append(Continued(values=values, kept=kept, pauses=parts))
    return out


def _rests(path: Array) -> list[tuple[int, int]]:
    """Return start and end of the intervals in which a path (n, D) rests."""
    if len(path) < 2:
        return []
    speed = np.convolve(_speed(path), np.ones(_SMOOTHED) / _SMOOTHED, "same")
    is_slow = speed < _SPEED * np.sqrt(np.mean(speed**2))
    return [(a, b) for a, b in runs(is_slow) if b - a >= _LEAST]


def _speed(path: Array) -> Array:
    """Return the speed (n,) along a path (n, D), per sample."""
    return np.asarray(np.linalg.norm(np.gradient(path, axis=0), axis=1))
