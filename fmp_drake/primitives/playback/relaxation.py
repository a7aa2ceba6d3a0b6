"""How weights come closer to their target: the motion that Algorithm 2 prescribes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Relaxation:
    """How a deviation of the weights from their target decays under one component.

    Along each mode (a column of an orthonormal basis) it decays exponentially with
    a rate of its own, in the orthogonal complement of the modes with a common one.

    Attributes
    ----------
    modes : ndarray, shape (n, r), or None
        None: every weight is a mode of its own, so r = n.
    rates : ndarray, shape (r,)
        Per second.
    complement_rate : float
        Per second, in the orthogonal complement.
    euler_tick : float
        Seconds in which one step of Euler's method is made, with linear motion in
        between, instead of the exponential decay; 0 for the exponential.
    """

    modes: NDArray[np.float64] | None
    rates: NDArray[np.float64]
    complement_rate: float = 0.0
    euler_tick: float = 0.0

    def rates_by_channel(self, channels: int) -> NDArray[np.float64]:
        """Return the rates that the weights of each of D channels show, (D, m).

        They are those of all modes and of their orthogonal complement; where every
        weight is a mode of its own, those of the channel's weights.
        """
        if self.modes is None:
            return self.rates.reshape(channels, -1)
        return np.tile([*self.rates, self.complement_rate], (channels, 1))

    def split(
        self, deviation: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Split deviations (..., n) into coordinates (..., r) and residuals (..., n)."""
        if self.modes is None:
            return deviation, np.zeros_like(deviation)
        inside = deviation @ self.modes
        return inside, deviation - inside @ self.modes.T

    def left(
        self, seconds: float | NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what is left of the modes (..., r) and of their complement (..., 1).

        Parameters
        ----------
        seconds : float or ndarray
            Since the deviation was whole.
        """
        t = np.asarray(seconds)[..., None]
        complement = np.exp(-self.complement_rate * t)
        if self.euler_tick <= 0:
            return np.exp(-self.rates * t), complement
        ticks, rest = np.divmod(t, self.euler_tick)
        one_tick = 1 - self.rates * self.euler_tick
        return one_tick**ticks * (1 - self.rates * rest), complement

    def loss(self, seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how fast `left` falls, per second; Euler's method: in the first tick."""
        left, complement = self.left(0.0 if self.euler_tick > 0 else seconds)
        return self.rates * left, self.complement_rate * complement

    def after(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        """Return the weights, shape (n,), some seconds later.

        Parameters
        ----------
        weights, target : ndarray, shape (n,)
        seconds : float
        """
        deviation = weights - target
        if not deviation.any():
            return target
        left, complement = self.left(seconds)
        if self.modes is None:
            return target + left * deviation
        inside, residual = self.split(deviation)
        out: NDArray[np.float64] = self.modes @ (left * inside)
        out += complement * residual
        out += target
        return out
