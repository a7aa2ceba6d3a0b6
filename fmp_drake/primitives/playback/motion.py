"""Desired motion of a playback, in closed form up to its next re-mapping."""

import math
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.linalg import pascal

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.trackers import Relaxation


class Motion(np.ndarray[tuple[Any, ...], np.dtype[np.float64]]):
    """Position, velocity and acceleration: an array (..., 3, D) with named rows.

    Slices of it and results of arithmetic are plain arrays.

    Parameters
    ----------
    values : ndarray, shape (..., 3, D)
        Value, velocity (per second) and acceleration (per second^2) of each channel.
    time : ndarray, shape (N,), optional
        Time of each of N samples since the start, s; None for a single instant.

    Examples
    --------
    >>> motion = Motion(np.arange(12.0).reshape(2, 3, 2), time=np.array([0.0, 0.05]))
    >>> motion.time
    array([0.  , 0.05])
    >>> motion.position
    array([[0., 1.],
           [6., 7.]])
    >>> motion.acceleration[-1]
    array([10., 11.])
    """

    time: Array | None = None

    def __new__(cls, values: Array, *, time: Array | None = None) -> Self:
        """Name the rows of an array, which is not copied."""
        motion = values.view(cls)
        motion.time = time
        return motion

    def __array_finalize__(self, array: Any) -> None:
        """Keep the times in copies."""
        self.time = getattr(array, "time", None)

    def __reduce__(self) -> Any:
        """Keep the times in a pickle."""
        reduced: Any = super().__reduce__()
        make, arguments, state = reduced
        return make, arguments, (*state, self.time)

    def __setstate__(self, state: Any) -> None:
        """Restore the array and the times of a pickle."""
        *array, self.time = state
        super().__setstate__(tuple(array))

    @property
    def position(self) -> Array:
        """The value of each channel, shape (..., D)."""
        return self[..., 0, :]

    @property
    def velocity(self) -> Array:
        """Per second, shape (..., D)."""
        return self[..., 1, :]

    @property
    def acceleration(self) -> Array:
        """Per second^2, shape (..., D)."""
        return self[..., 2, :]

    def __getitem__(self, key: Any) -> Any:
        """Return a slice as a plain array."""
        return self.view(np.ndarray)[key]

    def __iter__(self) -> Any:
        """Iterate over the first axis as plain arrays."""
        return iter(self.view(np.ndarray))

    def __array_wrap__(self, array: Any, *_: Any) -> Any:
        """Return the result of arithmetic as a plain array."""
        return array[()]


class Segment(NamedTuple):
    """Motion of a playback from an instant to its next tick.

    Between two samples a window is a polynomial of degree 5 in time, and every mode of
    the weights' deviation decays exponentially. A segment holds the polynomial of each
    mode and channel, so the cost of an evaluation does not depend on the window's
    length.

    Attributes
    ----------
    coefficients : ndarray, shape (D, m, 6)
        Factors of the powers 0 to 5 of the skill's time since the tick, for each of m
        modes. The last mode is the target, which does not decay.
    rates : ndarray, shape (D, m)
        Rate of decay of each mode, per second of the skill.
    linear : bool
        Whether the decay is linear, as in Euler's method.
    time_since_tick, tempo, tempo_rate : float
        As in `PlaybackState`.
    offset : ndarray, shape (2, D)
        As in `PlaybackState`.
    blend_time : float
        As in `PlaybackState`, s.
    """

    coefficients: Array
    rates: Array
    linear: bool
    time_since_tick: float
    tempo: float
    tempo_rate: float
    offset: Array
    blend_time: float


def make_segment(
    skill: FourierMovementPrimitive, relaxation: Relaxation, state: PlaybackState
) -> Segment:
    """Prepare the motion from a state to its next tick.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    relaxation : Relaxation
        That of the tracked component.
    state : PlaybackState
    """
    d, n = skill.n_channels_, skill.n_steps
    interval = min(state.step, n - 2)
    rows = skill.basis.local_polynomial(interval)
    if interval != state.step:
        # At the last sample: the last interval's polynomial about its end.
        rows = pascal(len(rows), kind="upper") @ rows
    rows = rows * (skill.rate ** np.arange(len(rows)))[:, None]
    steady = (state.target.reshape(d, n) @ rows.T)[:, None]
    coefficients, rates = steady, np.zeros((d, 1))
    deviation = state.weights - state.target
    if deviation.any():  # Weights on target have nothing to decay.
        if relaxation.modes is None:
            decaying = rows.T * deviation.reshape(d, n, 1)
        else:
            decaying = mode_coefficients(
                rows, relaxation.modes, *relaxation.split(deviation), d
            )
        coefficients = np.concatenate([decaying, steady], axis=1)
        rates = np.concatenate([relaxation.rates_by_channel(d), rates], axis=1)
    return Segment(
        coefficients=coefficients * skill.scales_[:, None, None],
        rates=rates,
        linear=relaxation.euler_tick > 0,
        time_since_tick=state.time_since_tick,
        tempo=state.tempo,
        tempo_rate=state.tempo_rate,
        offset=state.offset,
        blend_time=state.blend_time,
    )


@compiled
def segment_motion(segment: Segment, seconds: float) -> Array:
    """Return the desired motion some seconds after the beginning of a segment.

    Parameters
    ----------
    segment : Segment
    seconds : float
        Real time.

    Returns
    -------
    ndarray, shape (3, D)
        Value, velocity (per second) and acceleration (per second^2) of every channel.
    """
    tempo = segment.tempo + segment.tempo_rate * seconds
    t = segment.time_since_tick + 0.5 * (segment.tempo + tempo) * seconds
    channels, modes = segment.rates.shape
    out = np.zeros((3, channels))
    offset = decayed_offset(segment.offset, segment.blend_time, seconds)
    for d in range(channels):
        for j in range(modes):
            c, rate = segment.coefficients[d, j], segment.rates[d, j]
            if segment.linear:
                decay, decay_dt, decay_dt2 = 1 - rate * t, -rate, 0.0
            else:
                decay = math.exp(-rate * t)
                decay_dt, decay_dt2 = -rate * decay, rate * rate * decay
            p = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
            dp = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + 5 * t * c[5])))
            ddp = 2 * c[2] + t * (6 * c[3] + t * (12 * c[4] + 20 * t * c[5]))
            out[0, d] += p * decay
            out[1, d] += dp * decay + p * decay_dt
            out[2, d] += ddp * decay + 2 * dp * decay_dt + p * decay_dt2
        # From the skill's time to real time.
        out[2, d] = tempo * tempo * out[2, d] + segment.tempo_rate * out[1, d]
        out[1, d] *= tempo
        for k in range(3):
            out[k, d] += offset[k, d]
    return out


@compiled
def decayed_offset(offset: Array, blend_time: float, seconds: float) -> Array:
    """Return an offset that decays like a critically damped spring for some seconds.

    Parameters
    ----------
    offset : ndarray, shape (2, D)
        Value and velocity.
    blend_time : float
        Time constant, s.
    seconds : float

    Returns
    -------
    ndarray, shape (3, D)
        Value, velocity and acceleration.
    """
    rate = 1 / blend_time
    decay = math.exp(-rate * seconds)
    out = np.empty((3, offset.shape[1]))
    for d in range(offset.shape[1]):
        speed = offset[1, d] + rate * offset[0, d]
        value, speed = decay * (offset[0, d] + speed * seconds), decay * speed
        out[0, d] = value
        out[1, d] = speed - rate * value
        out[2, d] = rate * (rate * value - 2 * speed)
    return out


@compiled
def mode_coefficients(
    rows: Array,
    modes: Array,
    coordinates: Array,
    residual: Array,
    channels: int,
) -> Array:
    """Return the coefficients of the decaying modes, in units of the weights.

    Parameters
    ----------
    rows : ndarray, shape (6, T)
        Taylor coefficients of the basis, per second.
    modes : ndarray, shape (D*T, r)
    coordinates : ndarray, shape (r,)
        Coordinates of the weights' deviation from their target.
    residual : ndarray, shape (D*T,)
        Deviation outside the span of the modes.
    channels : int
        D.

    Returns
    -------
    ndarray, shape (D, r + 1, 6)
        Those of the modes and of the residual.
    """
    n, r = rows.shape[1], len(coordinates)
    out = np.empty((channels, r + 1, len(rows)))
    for d in range(channels):
        channel = slice(d * n, (d + 1) * n)
        values = np.dot(rows, modes[channel])
        for k in range(len(rows)):
            for j in range(r):
                out[d, j, k] = values[k, j] * coordinates[j]
            out[d, r, k] = np.dot(rows[k], residual[channel])
    return out


class LookAhead(NamedTuple):
    """Values at the next ticks of a window, an affine function of the target.

    Attributes
    ----------
    steady : ndarray, shape (N, D)
        Values with the present target.
    response : ndarray, shape (N, D, r)
        Change of the values per unit change of the target along each of the component's
        directions.
    """

    steady: Array
    response: Array


def look_ahead_at_once(
    skill: FourierMovementPrimitive,
    state: PlaybackState,
    motion: Array,
) -> tuple[Array, Array]:
    """Return the values at the next ticks where the weights are replaced at once.

    The offset absorbs the difference, so that position and velocity, (2, D), do not jump.

    Returns
    -------
    steady : ndarray, shape (N, D)
        Contribution of the motion to the values at the next ticks.
    rows : ndarray, shape (N, T)
        Factors of the new weights of a channel.
    """
    now, step = state.time_since_tick, np.arange(state.step + 1, skill.n_steps)
    tempo = state.tempo if state.tempo > 0 else 1.0
    seconds = ((step - state.step) / skill.rate - now) / tempo
    offset = _offset_response(state, seconds)
    present = min(state.step + now * skill.rate, skill.n_steps - 1)
    rows = skill.basis.local_rows(present)[:2] * [[1.0], [skill.rate * tempo]]
    return offset @ motion, skill.basis.rows(step) - offset @ rows


def look_ahead(
    skill: FourierMovementPrimitive,
    relaxation: Relaxation,
    state: PlaybackState,
    *,
    responses: bool = True,
) -> LookAhead:
    """Return the values at the next ticks, at a state's tempo (1 where that is 0).

    They equal those of `Player.retarget` and `Player.advance` for each target.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    relaxation : Relaxation
        That of the tracked component.
    state : PlaybackState
        Before the last sample of its window.
    responses : bool
        Whether the response is computed; else r is 0.
    """
    d, n = skill.n_channels_, skill.n_steps
    directions = skill.components_[state.component].basis
    if not responses:
        directions = directions[:, :0]
    deviations = np.column_stack([state.weights - state.target, directions])
    whole = np.column_stack([state.target, directions]).reshape(d, n, -1)
    now, step = state.time_since_tick, np.arange(state.step + 1, n)
    since_tick = (step - state.step) / skill.rate
    tempo = state.tempo if state.tempo > 0 else 1.0
    offset = _offset_response(state, (since_tick - now) / tempo)
    rows = skill.basis.rows(step)
    out = rows @ whole
    if deviations.any():  # Weights on target have nothing to decay.
        coordinates, residual = relaxation.split(deviations.T)
        modes = np.eye(d * n) if relaxation.modes is None else relaxation.modes

        def decayed(
            rows: Array,
            decay: tuple[Array, Array],
        ) -> Array:
            """Return k rows of the basis times the deviations, shape (D, k, 1 + r)."""
            modal, complement = decay
            out = ((rows @ modes.reshape(d, n, -1)) * modal) @ coordinates.T
            out += complement * (rows @ residual.T.reshape(d, n, -1))
            return out

        decaying = decayed(rows, relaxation.decay(since_tick))
        out[..., 0] += decaying[..., 0]
        out[..., 1:] -= decaying[..., 1:]
        # The offset absorbs the change of value and velocity at a change of the target.
        rows = skill.basis.local_rows(min(state.step + now * skill.rate, n - 1))[:2]
        rows[1] *= skill.rate
        change = rows @ whole - decayed(rows, relaxation.decay(now))
        change[:, 1] += decayed(rows[:1], relaxation.decay_rate(now))[:, 0]
        change[:, 1] *= tempo
        out[..., 1:] -= offset @ change[..., 1:]
    out = np.swapaxes(out * skill.scales_[:, None, None], 0, 1)
    out[..., 0] += offset @ state.offset
    return LookAhead(out[..., 0], out[..., 1:])


def _offset_response(state: PlaybackState, seconds: Array) -> Array:
    """Return the later values of an offset of unit value and unit velocity, (N, 2)."""
    unit = np.eye(2)
    return np.array([decayed_offset(unit, state.blend_time, t)[0] for t in seconds])
