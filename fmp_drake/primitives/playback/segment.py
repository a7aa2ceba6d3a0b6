"""The desired motion between two ticks, in closed form."""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pascal

from fmp_drake.compiled import compiled
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.relaxation import Relaxation

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


class Segment(NamedTuple):
    """The motion of a playback from an instant to its next tick.

    Between two samples a window is a polynomial of degree 5 in time, and every mode of
    the weights' deviation decays exponentially. A segment holds the polynomial that each
    mode contributes to each channel, so that one evaluation is a short sum, however
    long the window is.

    Attributes
    ----------
    coefficients : ndarray, shape (D, m, 6)
        Of the powers 0 to 5 of the skill's time since the tick, for each of m modes, of
        which the last one is the target, that lasts.
    rates : ndarray, shape (D, m)
        At which each mode decays, per second of the skill.
    linear : bool
        Whether the decay is the linear one of Euler's method.
    time_since_tick, tempo, tempo_rate : float
        As in `PlaybackState`.
    offset : ndarray, shape (2, D)
        As in `PlaybackState`.
    blend_time : float
        As in `PlaybackState`, s.
    """

    coefficients: NDArray[np.float64]
    rates: NDArray[np.float64]
    linear: bool
    time_since_tick: float
    tempo: float
    tempo_rate: float
    offset: NDArray[np.float64]
    blend_time: float


def make_segment(
    skill: "FourierMovementPrimitive", relaxation: Relaxation, state: PlaybackState
) -> Segment:
    """Prepare the motion from a state to its next tick.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    relaxation : Relaxation
        Of the component that is tracked.
    state : PlaybackState
    """
    d, n = skill.n_channels_, skill.n_steps
    interval = min(state.step, n - 2)
    rows = skill.basis.local_polynomial(interval)
    if interval != state.step:
        # At the last sample: the last interval's, seen from one sample further on.
        rows = pascal(len(rows), kind="upper") @ rows
    rows = rows * (skill.rate ** np.arange(len(rows)))[:, None]
    lasting = (state.target.reshape(d, n) @ rows.T)[:, None]
    coefficients, rates = lasting, np.zeros((d, 1))
    deviation = state.weights - state.target
    if deviation.any():  # Else it is played at once: there is nothing to decay.
        if relaxation.modes is None:
            decaying = rows.T * deviation.reshape(d, n, 1)
        else:
            decaying = mode_coefficients(
                rows, relaxation.modes, *relaxation.split(deviation), d
            )
        coefficients = np.concatenate([decaying, lasting], axis=1)
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
def segment_motion(segment: Segment, seconds: float) -> NDArray[np.float64]:
    """Return the desired motion some seconds after the beginning of a segment.

    Parameters
    ----------
    segment : Segment
    seconds : float
        Of real time.

    Returns
    -------
    ndarray, shape (3, D)
        Value, velocity (per second) and acceleration (per second^2) of every channel.
    """
    tempo = segment.tempo + segment.tempo_rate * seconds
    t = segment.time_since_tick + 0.5 * (segment.tempo + tempo) * seconds
    channels, modes = segment.rates.shape
    out = np.zeros((3, channels))
    for d in range(channels):
        for j in range(modes):
            c, rate = segment.coefficients[d, j], segment.rates[d, j]
            if segment.linear:
                left, falling, bending = 1 - rate * t, -rate, 0.0
            else:
                left = math.exp(-rate * t)
                falling, bending = -rate * left, rate * rate * left
            p = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
            dp = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + 5 * t * c[5])))
            ddp = 2 * c[2] + t * (6 * c[3] + t * (12 * c[4] + 20 * t * c[5]))
            out[0, d] += p * left
            out[1, d] += dp * left + p * falling
            out[2, d] += ddp * left + 2 * dp * falling + p * bending
        # From the skill's time to real time.
        out[2, d] = tempo * tempo * out[2, d] + segment.tempo_rate * out[1, d]
        out[1, d] *= tempo
    return out + decayed_offset(segment.offset, segment.blend_time, seconds)


@compiled
def decayed_offset(
    offset: NDArray[np.float64], blend_time: float, seconds: float
) -> NDArray[np.float64]:
    """Return an offset some seconds later: it decays like a critically damped spring.

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
    left = math.exp(-rate * seconds)
    out = np.empty((3, offset.shape[1]))
    for d in range(offset.shape[1]):
        speed = offset[1, d] + rate * offset[0, d]
        value, speed = left * (offset[0, d] + speed * seconds), left * speed
        out[0, d] = value
        out[1, d] = speed - rate * value
        out[2, d] = rate * (rate * value - 2 * speed)
    return out


@compiled
def mode_coefficients(
    rows: NDArray[np.float64],
    modes: NDArray[np.float64],
    inside: NDArray[np.float64],
    residual: NDArray[np.float64],
    channels: int,
) -> NDArray[np.float64]:
    """Return the coefficients of what decays mode by mode, in units of the weights.

    Parameters
    ----------
    rows : ndarray, shape (6, T)
        Taylor coefficients of the basis, per second.
    modes : ndarray, shape (D*T, r)
    inside : ndarray, shape (r,)
        Coordinates of the weights' deviation from their target.
    residual : ndarray, shape (D*T,)
        The deviation outside the span of the modes.
    channels : int
        D.

    Returns
    -------
    ndarray, shape (D, r + 1, 6)
        Of the modes and of the residual.
    """
    n, r = rows.shape[1], len(inside)
    out = np.empty((channels, r + 1, len(rows)))
    for d in range(channels):
        of_d = slice(d * n, (d + 1) * n)
        seen = np.dot(rows, modes[of_d])
        for k in range(len(rows)):
            for j in range(r):
                out[d, j, k] = seen[k, j] * inside[j]
            out[d, r, k] = np.dot(rows[k], residual[of_d])
    return out
