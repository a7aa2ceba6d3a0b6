"""From what was recorded of a hand to demonstrations with the rhythm of the hand."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from fmp_drake.numeric import as_floats
from fmp_drake.primitives.data.demonstration import Demonstration

Array = NDArray[np.float64]

# A hand slower than this is still, m/s, over so many samples to both sides.
_STILL, _AROUND = 0.02, 2
# What a clock may be off without a meaning, and the longest time without a sample, s.
_JITTER, _GAP = 0.02, 0.25


def hand_time(simulated: ArrayLike, clock: ArrayLike) -> Array:
    """Return when a hand did what a simulation recorded, shape (N,), s.

    A simulation that falls behind shows a hand's movement slower than it was. Its own time
    is as good as the clock's to 20 ms, and free of jitter: it is moved by no more than
    it takes to stay that near to the clock.

    Parameters
    ----------
    simulated : array_like, shape (N,)
        The simulation's time of each sample, s.
    clock : array_like, shape (N,)
        When it was simulated, s.

    Examples
    --------
    >>> hand_time([0.0, 0.1, 0.2, 0.3], [5.0, 5.1, 5.6, 5.7]).round(2)
    array([5.  , 5.1 , 5.58, 5.68])
    """
    time = as_floats(simulated, "the simulated time")
    behind = as_floats(clock, "the clock") - time
    now = behind[0] if len(behind) else 0.0
    for i, each in enumerate(behind):
        now = min(max(now, each - _JITTER), each + _JITTER)
        behind[i] = now
    return time + behind


def led_demonstrations(
    time: ArrayLike,
    position: ArrayLike,
    leads: ArrayLike,
    *,
    rate: float = 20.0,
    frame_seconds: float = 0.0,
    note: str = "",
) -> list[Demonstration]:
    """Return what a hand has shown: one demonstration for each time that it led.

    The still beginning and end are cut off, and what was missed while nothing could be
    recorded is left out: there one demonstration ends and the next begins.

    Parameters
    ----------
    time : array_like, shape (N,)
        s.
    position : array_like, shape (N, 3)
        In the frame of the board, m.
    leads : array_like, shape (N,)
        Whether the hand led.
    rate : float
        Samples per second of the demonstrations.
    frame_seconds : float
        How long each picture stood on the page that the hand moved on. Where this is longer
        than a sample it has left steps in the path, and the path is averaged over it.
    note : str

    Examples
    --------
    >>> time = np.arange(0.0, 10.0, 0.05)
    >>> x = np.sin(np.maximum(time - 4.0, 0.0))  # Still for 4 s.
    >>> path = np.column_stack([x, x, 0 * x])
    >>> [shown] = led_demonstrations(time, path, np.ones(200))
    >>> bool(abs(shown.duration - 6.0) < 0.2)
    True
    """
    t, p = as_floats(time, "the time"), as_floats(position, "the position")
    led = np.flatnonzero(np.asarray(leads, dtype=bool))
    ends = np.flatnonzero((np.diff(led) > 1) | (np.diff(t[led]) > _GAP)) + 1
    found = []
    for part in np.split(led, ends):
        kept = part[_moving(t[part], p[part])]
        if len(kept) < 8:
            continue
        shown = Demonstration(
            time=t[kept] - t[kept[0]],
            values=p[kept],
            channels=("x", "y", "z"),
            units=("m", "m", "m"),
            frame="board",
            note=note,
        ).resample(rate)
        found.append(_averaged(shown, frame_seconds, rate))
    return found


def _moving(time: Array, position: Array) -> slice:
    """Return what is left without the still beginning and end."""
    n = len(time)
    if n <= 2 * _AROUND:
        return slice(0, 0)
    low = np.maximum(np.arange(n) - _AROUND, 0)
    high = np.minimum(np.arange(n) + _AROUND, n - 1)
    way = np.linalg.norm(position[high] - position[low], axis=1)
    moving = np.flatnonzero(way > _STILL * (time[high] - time[low]))
    return slice(int(moving[0]), int(moving[-1]) + 1) if len(moving) else slice(0, 0)


def _averaged(
    demonstration: Demonstration, seconds: float, rate: float
) -> Demonstration:
    """Return the mean over so many seconds around each sample."""
    if seconds * rate <= 1:
        return demonstration
    time = demonstration.time
    half = np.minimum(seconds / 2, np.minimum(time - time[0], time[-1] - time))
    half = np.maximum(half, 1e-6)
    way = CubicSpline(time, demonstration.values).antiderivative()
    mean = (way(time + half) - way(time - half)) / (2 * half)[:, None]
    return replace(demonstration, values=mean)
