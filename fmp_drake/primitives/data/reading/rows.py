"""Rows of a table that are used, and values that are interpolated between them."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from fmp_drake.numeric import Array, Mask
from fmp_drake.primitives.data.channels import (
    EULER_CHANNELS,
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    QUATERNION_CHANNELS,
)
from fmp_drake.primitives.data.reading.table import LONGEST_GAP, Column, count_text

LEAST_COMPLETE = 0.5
"""Least fraction of samples in which all channels have a value."""
# Positions that jump: least speed, m/s, and relative to nine tenths of the others; the most
# samples in a row, and the greatest fraction of all samples.
_FASTEST, _FASTER, _MOST_JUMPING, _MOST_JUMPS = 5.0, 5.0, 3, 0.05


def interpolated(
    time: Array, values: Array, channels: Mapping[str, Column], remarks: list[str]
) -> tuple[Array, Mask]:
    """Interpolate channels of other sensors, which have rows or a rate of their own.

    Returns values (n, C), and a mask (n,) of the samples with a position, to be kept. Nothing
    changes where most samples are complete, or where the position is unknown for most of the
    time. Nothing is interpolated over gaps.
    """
    known = ~np.isnan(values)
    axes = np.isin(list(channels), POSITION_CHANNELS)
    is_placed = np.all(known[:, axes], axis=1)
    others = np.flatnonzero(~np.all(known[is_placed], axis=0))
    is_sparse = np.count_nonzero(known[:, others], axis=0) < 2
    are_most = np.mean(np.all(known, axis=1)) > LEAST_COMPLETE
    order = list(channels)
    forces = np.isin(order, (FORCE_CHANNEL, *FORCE_COMPONENTS))
    is_usual = are_most or not axes.any() or bool(np.any(is_sparse))
    if is_usual or not (len(others) or _is_slower(time, known[:, axes])):
        return values, np.ones(len(values), dtype=bool)
    if not len(others):  # Faster sensors have values in all rows.
        count = count_text(len(values) - int(np.count_nonzero(is_placed)), "sample")
        remarks.append(f"{count} without a position left out, of faster sensors")
    values = values.copy()
    for i in {*others, *np.flatnonzero(forces)}:
        rows = known[:, i]
        new = at_times(time[is_placed], time[rows], values[rows, i], name=order[i])
        values[is_placed, i] = np.where(np.isnan(new), values[is_placed, i], new)
    index = [order.index(n) for n in QUATERNION_CHANNELS if n in channels]
    rows = np.all(known[:, index], axis=1)
    is_new = ~rows & ~np.any(np.isnan(values[:, index]), axis=1)
    if len(index) == 4 and np.count_nonzero(rows) > 1 and np.any(is_new):
        quaternions = values[np.ix_(rows, index)]
        values[np.ix_(is_new, index)] = slerp(time[is_new], time[rows], quaternions)
    if names := ", ".join(order[i] for i in others):
        remarks.append(f"{names} interpolated at the times of the position")
    return values, is_placed


def _is_slower(time: Array, known: Mask) -> bool:
    """Return whether samples (n, C) have all values or none, as those of a slower sensor.

    Gaps between those with values may take half of the time.
    """
    is_known = np.any(known, axis=1)
    if not np.array_equal(is_known, np.all(known, axis=1)):
        return False
    steps = np.diff(time[is_known])
    covered = float(np.sum(steps[steps <= LONGEST_GAP]))
    return covered >= LEAST_COMPLETE * float(time[-1] - time[0])


def at_times(time: Array, stamps: Array, values: Array, *, name: str) -> Array:
    """Return values (N,) of increasing stamps (N,), s, at times (n,); NaN outside and in gaps.

    Forces of a faster sensor are averaged over an interval of the times: single ones of a
    tool that vibrates would look like a slow change. Angles may jump by a revolution.
    """
    if name in (FORCE_CHANNEL, *FORCE_COMPONENTS) and len(time) > 1:
        values = _averaged(stamps, values, float(np.median(np.diff(np.sort(time)))))
    turn = _revolution(values) if name in EULER_CHANNELS else None
    smooth = values if turn is None else np.unwrap(values, period=turn)
    after = np.searchsorted(stamps, time).clip(1, len(stamps) - 1)
    is_near = stamps[after] - stamps[after - 1] <= LONGEST_GAP
    is_inside = (stamps[0] <= time) & (time <= stamps[-1])
    new = np.where(is_near & is_inside, np.interp(time, stamps, smooth), np.nan)
    least = np.min(values)
    return new if turn is None else (new - least) % turn + least


def _averaged(stamps: Array, values: Array, interval: float) -> Array:
    """Return values (N,) of increasing stamps (N,), s, averaged over an interval around each.

    The samples may come in bursts. NaN remain, and do not count.
    """
    half = 0.501 * interval  # Also those at both ends.
    first = np.searchsorted(stamps, stamps - half)
    last = np.searchsorted(stamps, stamps + half, side="right")
    known = ~np.isnan(values)
    count, total = (
        np.append(0.0, np.cumsum(x)) for x in (known, np.where(known, values, 0.0))
    )
    mean = (total[last] - total[first]) / np.maximum(count[last] - count[first], 1.0)
    return np.where(known, mean, np.nan)


def _revolution(angles: Array) -> float | None:
    """Return the revolution, 360 or 2 pi, by which angles jump; None where they do not."""
    jump, span = np.max(np.abs(np.diff(angles)), initial=0.0), np.ptp(angles)
    for revolution in (360.0, 2 * np.pi):
        if jump > 0.75 * revolution and span < 1.02 * revolution:
            return revolution
    return None


def slerp(time: Array, stamps: Array, quaternions: Array) -> Array:
    """Return quaternions (N, 4) of stamps (N,), s, at times (n,); the ends outside.

    They follow the rotation from one to the next, whatever their signs. Their lengths are
    interpolated, too, so that wrong ones are still found.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    unit = np.where(lengths[:, None] > 0, quaternions, [0.0, 0.0, 0.0, 1.0])
    inside = time.clip(stamps[0], stamps[-1])
    turned: Array = Slerp(stamps, Rotation.from_quat(unit))(inside).as_quat()
    return turned * np.interp(time, stamps, lengths)[:, None]


def steady_samples(time: Array, positions: Array, remarks: list[str]) -> Mask:
    """Return a mask (n,) of the samples without positions (n, D), m, that jump away and back.

    Lost tracking gives such positions in up to three samples, also at the ends.
    """
    is_steady = np.ones(len(time), dtype=bool)
    is_short = len(time) < _MOST_JUMPING / _MOST_JUMPS
    # Infinite numbers are refused later.
    if is_short or not positions.shape[1] or not np.isfinite(positions).all():
        return is_steady
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    intervals = np.diff(time)
    # Some clocks stamp several samples at almost the same time.
    speeds = steps / np.maximum(intervals, np.median(intervals))
    fastest = max(_FASTEST, _FASTER * float(np.quantile(speeds, 0.9)))
    jumps = [0, *(np.flatnonzero(speeds > fastest) + 1).tolist(), len(time)]
    for a, b in pairwise(jumps[1:-1]):
        # Of two samples that jump to and fro, the first one is left out.
        if b - a <= _MOST_JUMPING and is_steady[a - 1]:
            distance = np.linalg.norm(positions[b] - positions[a - 1])
            is_steady[a:b] = distance > fastest * (time[b] - time[a - 1])
    for a, b, beside in (
        (0, jumps[1], jumps[1]),
        (jumps[-2], len(time), jumps[-2] - 1),
    ):
        if b - a <= _MOST_JUMPING and is_steady[beside]:
            is_steady[a:b] = False
    count = int(np.count_nonzero(~is_steady))
    if count > _MOST_JUMPS * len(time):
        return np.ones(len(time), dtype=bool)
    if count:
        largest = float(np.max(steps[speeds > fastest]))
        remarks.append(
            f"{count_text(count, 'sample')} left out whose position jumps, by up to "
            f"{largest:.3g} m"
        )
    return is_steady
