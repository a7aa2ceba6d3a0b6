"""Demonstrations from the recorded path of a hand, with the hand's timing."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fmp_drake.numeric import Array, as_floats
from fmp_drake.primitives import Demonstration, add_orientation
from fmp_drake.primitives.data.windows import DEFAULT_RATE

# Speed below which a hand is at rest, m/s, and samples on both sides for its average.
_REST_SPEED, _REST_SAMPLES = 0.02, 2
# Distance equivalent to a rotation, m/rad.
_LEVER = 0.2
# Tolerated difference of two clocks, and longest gap between samples, s.
_JITTER, _LONGEST_GAP = 0.02, 0.25


def hand_time(simulated: ArrayLike, clock: ArrayLike) -> Array:
    """Return the wall-clock time of samples that a simulation recorded, shape (N,), s.

    In a simulation that falls behind, the movement of a hand appears slower than it was.
    Simulated time has no jitter. It is shifted by the least amounts that keep it within
    20 ms of the clock.

    Parameters
    ----------
    simulated : array_like, shape (N,)
        Simulated time of each sample, s.
    clock : array_like, shape (N,)
        Wall-clock time of the simulation of each sample, s.

    Examples
    --------
    >>> hand_time([0.0, 0.1, 0.2, 0.3], [5.0, 5.1, 5.6, 5.7]).round(2)
    array([5.  , 5.1 , 5.58, 5.68])
    """
    time = as_floats(simulated, "the simulated time")
    delays = as_floats(clock, "the clock") - time
    shift = delays[0] if len(delays) else 0.0
    for i, delay in enumerate(delays):
        shift = min(max(shift, delay - _JITTER), delay + _JITTER)
        delays[i] = shift
    return time + delays


def guided_demonstrations(
    time: ArrayLike,
    position: ArrayLike,
    is_guided: ArrayLike,
    *,
    frame_seconds: float = 0.0,
    note: str = "",
    orientation: ArrayLike | None = None,
    reference: Rotation | None = None,
) -> list[Demonstration]:
    """Return one demonstration, at 20 Hz, for each interval of hand guiding.

    Rest at the start and at the end is trimmed. A gap in the samples separates two
    demonstrations.

    Parameters
    ----------
    time : array_like, shape (N,)
        s.
    position : array_like, shape (N, 3)
        In the frame of the board, m.
    is_guided : array_like, shape (N,)
        Whether the hand guided the tool.
    frame_seconds : float
        Time between two frames of the page with the mouse, s. If it is longer than a
        sample, the path has steps, and is averaged over this time.
    note : str
    orientation : array_like, shape (N, 4), optional
        R_BE, quaternions w, x, y, z, for demonstrations with rotation channels.
    reference : Rotation, optional
        Of the rotation channels; the mean of each demonstration if None.

    Examples
    --------
    >>> time = np.arange(0.0, 10.0, 0.05)
    >>> x = np.sin(np.maximum(time - 4.0, 0.0))  # At rest for 4 s.
    >>> path = np.column_stack([x, x, 0 * x])
    >>> [demonstration] = guided_demonstrations(time, path, np.ones(200))
    >>> bool(abs(demonstration.duration - 6.0) < 0.2)
    True
    """
    t, p = as_floats(time, "the time"), as_floats(position, "the position")
    rows = np.flatnonzero(np.asarray(is_guided, dtype=bool))
    ends = np.flatnonzero((np.diff(rows) > 1) | (np.diff(t[rows]) > _LONGEST_GAP)) + 1
    demonstrations, displacement = [], p
    if orientation is not None:
        R_BE = Rotation.from_quat(np.asarray(orientation)[:, [1, 2, 3, 0]])
        rotation = (R_BE * R_BE[0].inv()).as_rotvec() if len(t) else np.zeros((0, 3))
        displacement = np.column_stack([p, _LEVER * rotation])
    for interval in np.split(rows, ends):
        samples = interval[_moving_part(t[interval], displacement[interval])]
        if len(samples) < 8:
            continue
        demonstration = Demonstration(
            time=t[samples] - t[samples[0]],
            values=p[samples],
            frame="board",
            note=note,
        )
        if orientation is not None:
            demonstration = add_orientation(
                demonstration, R_BE[samples], reference=reference
            )
        demonstration = demonstration.resample(DEFAULT_RATE)
        demonstrations.append(_moving_average(demonstration, frame_seconds))
    return demonstrations


def _moving_part(time: Array, position: Array) -> slice:
    """Return the samples between the rest at the start and the rest at the end.

    The position, shape (N, D), may have more than 3 columns.
    """
    n = len(time)
    if n <= 2 * _REST_SAMPLES:
        return slice(0, 0)
    low = np.maximum(np.arange(n) - _REST_SAMPLES, 0)
    high = np.minimum(np.arange(n) + _REST_SAMPLES, n - 1)
    distance = np.linalg.norm(position[high] - position[low], axis=1)
    rows = np.flatnonzero(distance > _REST_SPEED * (time[high] - time[low]))
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)


def _moving_average(demonstration: Demonstration, seconds: float) -> Demonstration:
    """Return the moving average of a demonstration over an interval, s."""
    if seconds * DEFAULT_RATE <= 1:
        return demonstration
    time = demonstration.time
    half = np.minimum(seconds / 2, np.minimum(time - time[0], time[-1] - time))
    half = np.maximum(half, 1e-6)
    integral = CubicSpline(time, demonstration.values).antiderivative()
    mean = (integral(time + half) - integral(time - half)) / (2 * half)[:, None]
    return replace(demonstration, values=mean)
