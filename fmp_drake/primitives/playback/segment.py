"""The desired motion between two ticks, in closed form."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.tracking import Drift


def critically_damped(
    offset: NDArray[np.float64], rate: float, seconds: NDArray[np.floating[Any]] | float
) -> NDArray[np.float64]:
    """Return a critically damped decay and two derivatives.

    Parameters
    ----------
    offset : ndarray, shape (..., 2, D)
        Value and velocity at time 0.
    rate : float
        Per second.
    seconds : float or ndarray, shape (m,)

    Returns
    -------
    ndarray, shape (3, [m,] ..., D)
    """
    value, velocity = offset[..., 0, :], offset[..., 1, :]
    slope = velocity + rate * value
    decay: NDArray[np.float64] | float
    if isinstance(seconds, np.ndarray):
        seconds = seconds.reshape(-1, *[1] * value.ndim)
        decay = np.exp(-rate * seconds)
    else:
        decay = math.exp(-rate * seconds)
    here = (value + slope * seconds) * decay
    slope = slope * decay
    out = np.empty((3, *here.shape))
    out[0] = here
    out[1] = slope - rate * here
    out[2] = rate * (rate * here - 2 * slope)
    return out


class Segment:
    """Value, velocity and acceleration at any time within one tick.

    Between two samples a window is a polynomial of degree 5 in time, and the weights
    decay to their target mode by mode. Both are contracted here once, so that an
    evaluation costs a few small products whatever the length of the window.

    Parameters
    ----------
    polynomial : ndarray, shape (6, T)
        Taylor coefficients of the rows Phi at the tick, per sample.
    rate : float
        Samples per second.
    scales : ndarray, shape (D,)
        Units of the channels in units of the weights.
    drift : Drift
    weights, target : ndarray, shape (D*T,)
    offset : ndarray, shape (2, D)
    blend_rate : float
        Of the offset's decay, per second.
    """

    def __init__(
        self,
        *,
        polynomial: NDArray[np.float64],
        rate: float,
        scales: NDArray[np.float64],
        drift: Drift,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        offset: NDArray[np.float64],
        blend_rate: float,
    ) -> None:
        d = len(scales)
        self._drift = drift
        self._blend_rate = blend_rate
        # Taylor coefficients per second instead of per sample.
        powers = rate ** np.arange(len(polynomial))
        rows = polynomial * powers[:, None]
        # The target's polynomial, then the offset's two solutions.
        slope = offset[1] + blend_rate * offset[0]
        self._smooth = np.concatenate(
            [
                rows @ (target.reshape(d, -1) * scales[:, None]).T,
                offset[:1],
                slope[None],
            ]
        )
        inside, rest = drift.split(weights - target)
        if drift.modes is None:
            # Every weight of a channel is a mode: (6, D, T).
            modes = rows[:, None, :] * (inside.reshape(d, -1) * scales[:, None])
            self._rates_by_channel = True
        else:
            by_channel = drift.modes.reshape(d, rows.shape[1], len(inside))
            modes = np.transpose(rows @ by_channel, (1, 0, 2))
            modes *= scales[:, None] * inside
            self._rates_by_channel = False
        self._modes = modes.reshape(len(rows), -1)
        self._shape = (3, d, modes.shape[2])
        self._rest = None
        if rest is not None and np.max(np.abs(rest)) > 1e-12 * np.max(np.abs(weights)):
            self._rest = rows @ (rest.reshape(d, -1) * scales[:, None]).T

    def motion(self, seconds: float) -> NDArray[np.float64]:
        """Return value, velocity and acceleration after some seconds, (3, D)."""
        t = seconds
        t2 = t * t
        t3 = t2 * t
        t4 = t2 * t2
        r = self._blend_rate
        fading = math.exp(-r * t)
        table = np.array(
            (
                1.0, t, t2, t3, t4, t2 * t3, fading, fading * t,
                0.0, 1.0, 2 * t, 3 * t2, 4 * t3, 5 * t4, -r * fading,
                fading * (1 - r * t),
                0.0, 0.0, 2.0, 6 * t, 12 * t2, 20 * t3, r * r * fading,
                fading * r * (r * t - 2),
            )
        ).reshape(3, 8)  # fmt: skip
        out = table @ self._smooth
        powers = table[:, :6]
        decay = self._drift.decay(t)
        rows = (powers @ self._modes).reshape(self._shape)
        if self._rates_by_channel:
            decay = decay.reshape(3, *self._shape[1:])
            products = np.einsum("kdt,jdt->kdj", rows, decay)
        else:
            products = rows @ decay.T
        out[0] += products[0, :, 0]
        out[1] += products[1, :, 0] + products[0, :, 1]
        out[2] += products[2, :, 0] + 2 * products[1, :, 1] + products[0, :, 2]
        if self._rest is not None:
            rest = powers @ self._rest
            left = self._drift.rest_decay(t)
            out[0] += left[0] * rest[0]
            out[1] += left[0] * rest[1] + left[1] * rest[0]
            out[2] += left[0] * rest[2] + 2 * left[1] * rest[1] + left[2] * rest[0]
        return out
