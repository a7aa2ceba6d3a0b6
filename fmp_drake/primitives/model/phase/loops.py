"""Recordings of one cycle each: several that are joined, or one that closes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from fmp_drake.numeric import Array
from fmp_drake.primitives.model.phase.rhythm import Part

# Greatest distance between the end of one recording and the beginning of the next: relative to
# the size of the movement, or in steps from sample to sample up to another such distance.
_CLOSED, _STEPS, _MOST_OPEN = 0.3, 3.0, 0.7
# Last part of a recording in which one cycle may close.
_LAST_PART = 0.3
# Spread of a movement in a direction in which it is thin, relative to its greatest, and distance
# from it in such a direction where it ends, relative to its size.
_THIN, _AWAY = 0.35, 0.15
# Least distance between the ends of an approach or retreat, relative to its length, and
# standard deviation of the smoothing before, samples.
_DIRECT, _SMOOTHING = 0.4, 2.0
# Pauses at an end that are not reported: relative to the remainder of the recording, samples.
_SHORT, _FEW = 0.1, 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Loops:
    """Recordings of one cycle each, joined.

    Attributes
    ----------
    values : list of one ndarray, shape (n, D)
        The recordings without the pauses at their ends, one after another; a straight line
        joins the end of one to the beginning of the next.
    order : tuple of int
        Indices of the recordings in the order in which they are joined. The other
        attributes have this order.
    intervals : tuple of (int, int)
        First sample of each recording that is used, and the one after the last.
    starts : tuple of int
        Index in `values` of the first sample of each recording.
    lengths : tuple of int
        Samples of each recording.
    """

    values: list[Array]
    order: tuple[int, ...]
    intervals: tuple[tuple[int, int], ...]
    starts: tuple[int, ...]
    lengths: tuple[int, ...]

    def parts(self, parts: Sequence[Part], rate: float) -> list[Part]:
        """Convert parts of `values` to parts of the recordings, and add long pauses."""
        out = []
        loops = zip(self.order, self.intervals, self.starts, self.lengths, strict=True)
        for i, (first, stop), offset, length in loops:
            rests = ((0, first), (stop, length))
            for part in parts:
                start = max(part.start * rate - offset, 0) + first
                end = min(part.end * rate - offset + first, stop)
                if end > start:
                    out.append(
                        Part(
                            recording=i,
                            start=start / rate,
                            end=end / rate,
                            kind=part.kind,
                        )
                    )
            out += [
                Part(recording=i, start=a / rate, end=b / rate, kind="pause")
                for a, b in rests
                if _is_long(b - a, stop - first)
            ]
        return out


def join_loops(recordings: Sequence[Array], columns: list[int]) -> list[Loops]:
    """Join recordings (n, D) of one cycle each; return none where they are not.

    In an order of small gaps, each must begin about where the previous one ends.
    Distances are measured in `columns`.
    """
    if len(recordings) < 2:
        return []
    chosen = [y[:, columns] for y in recordings]
    size, step = _size_and_step(chosen)
    intervals = [
        (_end_of_rest(y, step), len(y) - _end_of_rest(y[::-1], step)) for y in chosen
    ]
    if any(after - first < 2 for first, after in intervals):
        return []
    loops = [y[a:b] for y, (a, b) in zip(recordings, intervals, strict=True)]
    order = _order_of_small_gaps([y[:, columns] for y in loops])
    loops = [loops[i] for i in order]
    pieces, starts = [loops[0]], [0]
    for before, loop in pairwise(loops):
        gap = loop[0] - before[-1]
        distance = float(np.linalg.norm(gap[columns]))
        if distance > _largest_gap(size, step):
            return []
        count = round(distance / step)
        if not count:
            # Both are one sample.
            pieces[-1] = pieces[-1][:-1]
        between = np.linspace(0.0, 1.0, count + 1)[1:-1]
        pieces.append(before[-1] + gap * between[:, None])
        starts.append(starts[-1] + len(before) + count - 1)
        pieces.append(loop)
    joined = Loops(
        values=[np.concatenate(pieces)],
        order=tuple(order),
        intervals=tuple(intervals[i] for i in order),
        starts=tuple(starts),
        lengths=tuple(len(recordings[i]) for i in order),
    )
    return [joined]


def closed_cycle(recording: Array, columns: list[int]) -> tuple[Array, int, int] | None:
    """Return the one closed cycle that a recording (n, D) is; None where it does not close.

    Its end is that of the recording. Where that is elsewhere because the recording goes on as
    it began, it is the sample that is nearest to the beginning. Long pauses at the ends are
    left out, and approach and retreat. Distances are measured in `columns`.

    Returns
    -------
    values : ndarray, shape (m, D)
        The cycle; a straight line joins its end to its beginning, which is repeated.
    first, after : int
        Its first sample in the recording, and the one after its last.
    """
    path = recording[:, columns]
    _, step = _size_and_step([path])
    rests = _end_of_rest(path, step), _end_of_rest(path[::-1], step)
    moving = len(path) - sum(rests)
    first, rest = (n if _is_long(n, moving) else 0 for n in rests)
    whole = slice(first, len(path) - rest)
    if whole.stop - whole.start < 2:
        return None
    inner = _without_approach(path, whole)
    for part in (inner, whole):
        if part is not None and (after := _end_of_cycle(path, part)) is not None:
            values = recording[part.start : after]
            gap = float(np.linalg.norm(path[after - 1] - path[part.start]))
            count = round(gap / step)
            line = np.linspace(values[-1], values[0], max(count, 1) + 1)[1:]
            # Without a distance, end and beginning are one sample.
            cycle = np.concatenate([values if count else values[:-1], line])
            return cycle, part.start, after
    return None


def _without_approach(path: Array, part: slice) -> slice | None:
    """Return a part of a path (n, D) without approach and retreat; None without these.

    They lead away from the movement in a direction in which its middle is thin: from the
    plane of a board. They take at most half of the path, and have no strokes.
    """
    values = path[part]
    quarter = len(values) // 4
    inside = slice(quarter, len(values) - quarter)
    middle = values[inside]
    centre = middle.mean(axis=0)
    spreads, axes = np.linalg.svd(middle - centre, full_matrices=False)[1:]
    thin = axes[spreads < _THIN * spreads[0]]
    heights = np.abs((values - centre) @ thin.T)
    size, _ = _size_and_step([middle])
    most = heights[inside].max(axis=0) + _AWAY * size
    away = np.flatnonzero(np.any(heights > most, axis=1))
    if not len(away):
        return None
    half = len(values) // 2
    first = int(np.max(away[away < half], initial=-1)) + 1
    after = int(np.min(away[away >= half], initial=len(values)))
    if not (is_direct(values[:first]) and is_direct(values[after:])):
        return None
    return slice(part.start + first, part.start + after)


def is_direct(path: Array) -> bool:
    """Return whether a path (n, D) leads from its beginning to its end, without strokes."""
    if len(path):  # Without noise, which makes a slow path long.
        path = gaussian_filter1d(path, _SMOOTHING, axis=0)
    length = np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1))
    return not length or bool(np.linalg.norm(path[-1] - path[0]) > _DIRECT * length)


def _end_of_cycle(path: Array, part: slice) -> int | None:
    """Return the sample after a cycle that is a part of a path (n, D), or its beginning."""
    first, after = part.start, part.stop
    if after - first < 2:
        return None
    near = _largest_gap(*_size_and_step([path[part]]))
    distances = np.linalg.norm(path[:after] - path[first], axis=1)
    if distances[-1] > near:
        last_part = after - round(_LAST_PART * (after - first))
        end = last_part + int(np.argmin(distances[last_part:])) + 1
        begin = path[first : first + 2 * (after - end)]
        if np.any(KDTree(begin).query(path[end:after])[0] > near):
            return None
        after = end
    return after if distances[after - 1] <= near else None


def _size_and_step(paths: Sequence[Array]) -> tuple[float, float]:
    """Return the size of paths (n, D), and their median step from sample to sample."""
    size = float(np.sqrt(np.concatenate(paths).var(axis=0).sum()))
    steps = [np.linalg.norm(np.diff(y, axis=0), axis=1) for y in paths]
    return size, max(float(np.median(np.concatenate(steps))), 1e-12)


def _largest_gap(size: float, step: float) -> float:
    """Return the greatest distance between the end of a cycle and the next beginning."""
    return max(_CLOSED * size, min(_STEPS * step, _MOST_OPEN * size))


def _is_long(rest: int, moving: int) -> bool:
    """Return whether a pause is long beside the samples of the movement."""
    return rest > max(_SHORT * moving, _FEW)


def _order_of_small_gaps(loops: Sequence[Array]) -> list[int]:
    """Order paths (n, D) so that each begins near the end of the previous one.

    Each path is followed by the nearest one that remains. Of all first paths, the one with
    the smallest total gap is taken.
    """
    starts, ends = (np.stack([y[end] for y in loops]) for end in (0, -1))
    gaps = np.linalg.norm(ends[:, None] - starts, axis=2)
    orders = []
    for first in range(len(loops)):
        order, remaining = [first], gaps.copy()
        while len(order) < len(loops):
            remaining[:, order] = np.inf
            order.append(int(np.argmin(remaining[order[-1]])))
        orders.append(order)
    return min(orders, key=lambda order: float(gaps[order[:-1], order[1:]].sum()))


def _end_of_rest(values: Array, step: float) -> int:
    """Return the last sample of a path (n, D) within one step of its first sample."""
    away = np.linalg.norm(values - values[0], axis=1) > step
    return int(np.argmax(away)) - 1 if away.any() else len(values)
