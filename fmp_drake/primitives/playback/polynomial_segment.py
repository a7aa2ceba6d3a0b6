"""The desired motion between two ticks as one polynomial."""

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.tracking import Drift

HORIZON = 1.5
"""How far a segment reaches, in ticks: a look-ahead leaves the tick."""

# What the series leave out, as a share of what decays.
_REMAINDER = 1e-14
_MOST_TERMS = 16
_DEGREE = 5  # Of the basis between two samples.


class PolynomialSegment:
    """Value, velocity and acceleration at any time within one tick.

    Parameters
    ----------
    coefficients : ndarray, shape (D, n)
        Of the powers 0 to n - 1 of the time in s.
    """

    def __init__(self, coefficients: NDArray[np.float64]) -> None:
        d, n = coefficients.shape
        self._powers = powers = np.arange(n)
        table = np.zeros((n, 3, d))
        table[:, 0] = coefficients.T
        table[:-1, 1] = table[1:, 0] * powers[1:, None]
        table[:-1, 2] = table[1:, 1] * powers[1:, None]
        self._table = table.reshape(n, 3 * d)

    def motion(self, seconds: float) -> NDArray[np.float64]:
        """Return value, velocity and acceleration after some seconds, (3, D)."""
        return (seconds**self._powers).dot(self._table).reshape(3, -1)


class PolynomialPlan:
    """Makes the segments of a component whose weights drift slowly.

    Between two samples a window is a polynomial of degree 5 in time, times the
    exponential decay of every mode. Where no decay is fast against a tick, its series
    of few terms is exact to rounding, and so is one polynomial for all.

    Parameters
    ----------
    drift : Drift
        With modes and an exponential decay.
    terms : int
        Of the series.
    rate : float
        Samples per second.
    scales : ndarray, shape (D,)
        Units of the channels in units of the weights.
    blend_rate : float
        Of the offset's decay, per second.
    """

    def __init__(
        self,
        drift: Drift,
        *,
        terms: int,
        rate: float,
        scales: NDArray[np.float64],
        blend_rate: float,
    ) -> None:
        self._drift, self._scales, self._blend_rate = drift, scales, blend_rate
        self._per_second = rate ** np.arange(_DEGREE + 1)[:, None]
        # The modes, then what is outside their span, then the offset.
        rates = np.concatenate([drift.rates, [drift.rest_rate, blend_rate]])
        series = np.ones((len(rates), terms))
        for k in range(1, terms):
            series[:, k] = series[:, k - 1] * -rates / k
        # From (power, mode) to the powers of the product with the mode's series.
        products = np.zeros((_DEGREE + 1, len(rates), terms + _DEGREE))
        for k in range(_DEGREE + 1):
            products[k, :, k : k + terms] = series
        self._products = products.reshape(-1, terms + _DEGREE)

    @classmethod
    def of(
        cls,
        drift: Drift,
        *,
        rate: float,
        scales: NDArray[np.float64],
        blend_rate: float,
    ) -> Self | None:
        """Return a plan, or None where a decay is fast or not exponential."""
        if drift.modes is None or drift.euler_tick > 0:
            return None
        fastest = max(*drift.rates, drift.rest_rate, blend_rate)
        x = fastest * HORIZON / rate
        for terms in range(1, _MOST_TERMS + 1):
            if x**terms <= _REMAINDER * math.factorial(terms):
                return cls(
                    drift, terms=terms, rate=rate, scales=scales, blend_rate=blend_rate
                )
        return None

    def segment(
        self,
        *,
        polynomial: NDArray[np.float64],
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        offset: NDArray[np.float64],
    ) -> PolynomialSegment:
        """Return the motion from a tick on.

        Parameters
        ----------
        polynomial : ndarray, shape (6, T)
            Taylor coefficients of the rows Phi at the tick, per sample.
        weights, target : ndarray, shape (D*T,)
        offset : ndarray, shape (2, D)
        """
        d, modes = len(self._scales), self._drift.modes
        assert modes is not None
        rows = polynomial * self._per_second
        deviation = weights - target
        inside = deviation @ modes
        rest = deviation - modes @ inside
        fixed, fading = rows @ np.stack([target, rest]).reshape(2, d, -1).swapaxes(1, 2)
        factors = np.zeros((d, _DEGREE + 1, len(inside) + 2))
        factors[..., :-2] = inside * (
            rows @ modes.reshape(d, rows.shape[1], len(inside))
        )
        factors[..., -2] = fading.T
        factors *= self._scales[:, None, None]
        factors[:, 0, -1] = offset[0]
        factors[:, 1, -1] = offset[1] + self._blend_rate * offset[0]
        coefficients = factors.reshape(d, -1) @ self._products
        coefficients[:, : _DEGREE + 1] += fixed.T * self._scales[:, None]
        return PolynomialSegment(coefficients)
