"""The orthonormal real Fourier basis of a window."""

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array, as_floats, check_number

_SPLINE_DEGREE = 5
# Fraction of a window, at its end, that is not played, and the fraction of these samples
# that is not replaced.
_UNPLAYED = 0.1
_KEPT = 0.3


class FourierBasis:
    """The real discrete Fourier transform of windows of `n_steps` samples.

    The paper keeps the real and imaginary parts of all T coefficients of a
    channel (6): 2T numbers of which half are copies, because the signal is
    real. Here a channel has T orthonormal weights, in this order::

        mean, cos 1, sin 1, cos 2, sin 2, ..., (Nyquist, where T is even)

    with the basis functions 1/sqrt(T), sqrt(2/T) cos(2 pi k n / T),
    sqrt(2/T) sin(2 pi k n / T) and (-1)^n / sqrt(T). The map to the paper's
    weights is `to_paper`: an isometry up to the factor sqrt(T).

    The weights of several channels are concatenated channel by channel (19),
    so a window of D channels has D*T weights.

    Parameters
    ----------
    n_steps : int
        Length T of a window, at least 8.

    Examples
    --------
    >>> import numpy as np
    >>> basis = FourierBasis(8)
    >>> window = np.cos(2 * np.pi * np.arange(8) / 8)[:, None]
    >>> basis.analyze(window).round(6)[1]  # Of the first harmonic's cosine.
    np.float64(2.0)
    >>> bool(np.allclose(basis.synthesize(basis.analyze(window)), window))
    True
    """

    def __init__(self, n_steps: int) -> None:
        check_number(n_steps, "n_steps", least=8, whole=True)
        self.n_steps = int(n_steps)
        self._polynomials: dict[int, Array] = {}

    def analyze(self, samples: ArrayLike) -> Array:
        """Return the weights (..., D*T) of windows of samples (..., T, D)."""
        n = self.n_steps
        y = as_floats(samples, "the samples", ("...", n, "channels"))
        spectrum = np.fft.rfft(np.swapaxes(y, -1, -2), axis=-1)
        w = np.empty((*spectrum.shape[:-1], n))
        last = (n + 1) // 2
        w[..., 0] = spectrum[..., 0].real / np.sqrt(n)
        w[..., 1 : 2 * last - 1 : 2] = np.sqrt(2 / n) * spectrum[..., 1:last].real
        w[..., 2 : 2 * last : 2] = -np.sqrt(2 / n) * spectrum[..., 1:last].imag
        if n % 2 == 0:
            w[..., -1] = spectrum[..., -1].real / np.sqrt(n)
        return w.reshape(*w.shape[:-2], w.shape[-2] * n)

    def synthesize(self, weights: ArrayLike) -> Array:
        """Return the windows of samples (..., T, D) that have weights (..., D*T)."""
        n = self.n_steps
        w = self.by_channel(weights)
        last = (n + 1) // 2
        spectrum = np.zeros((*w.shape[:-1], n // 2 + 1), dtype=complex)
        spectrum[..., 0] = w[..., 0] * np.sqrt(n)
        spectrum[..., 1:last] = np.sqrt(n / 2) * (
            w[..., 1 : 2 * last - 1 : 2] - 1j * w[..., 2 : 2 * last : 2]
        )
        if n % 2 == 0:
            spectrum[..., -1] = w[..., -1] * np.sqrt(n)
        return np.swapaxes(np.fft.irfft(spectrum, n=n, axis=-1), -1, -2)

    def by_channel(self, weights: ArrayLike) -> Array:
        """Return weights (..., D*T) with an axis for the channels, (..., D, T)."""
        w = as_floats(weights, "the weights")
        if w.ndim < 1 or w.shape[-1] == 0 or w.shape[-1] % self.n_steps:
            raise SkillError(
                f"the weights have shape {w.shape}; the last axis must be a "
                f"multiple of n_steps = {self.n_steps}."
            )
        channels = w.shape[-1] // self.n_steps
        return w.reshape(*w.shape[:-1], channels, self.n_steps)

    def series(self, steps: ArrayLike, derivative: int = 0) -> Array:
        """Return the values of all basis functions at any time, shape (..., T).

        Parameters
        ----------
        steps : array_like
            Times in samples from the start of the window; real numbers.
        derivative : int
            Order of the derivative, per sample^derivative.

        Notes
        -----
        Frequencies are wrapped to at most half the sampling rate, so the series
        is the smoothest periodic function through the samples. It is (4) at
        the samples. Between them it rings if the window does not close: see
        `rows`.
        """
        n = self.n_steps
        tau = np.asarray(steps, dtype=float)[..., None]
        omega = 2 * np.pi * np.arange(1, (n + 1) // 2) / n
        angle = omega * tau + derivative * np.pi / 2
        out = np.empty((*tau.shape[:-1], n))
        out[..., 0] = (derivative == 0) / np.sqrt(n)
        end = 2 * len(omega) + 1
        out[..., 1:end:2] = np.sqrt(2 / n) * omega**derivative * np.cos(angle)
        out[..., 2:end:2] = np.sqrt(2 / n) * omega**derivative * np.sin(angle)
        if n % 2 == 0:
            nyquist = np.pi * tau[..., 0] + derivative * np.pi / 2
            out[..., -1] = np.pi**derivative * np.cos(nyquist) / np.sqrt(n)
        return out

    def rows(self, steps: ArrayLike, derivative: int = 0) -> Array:
        """Return the rows Phi(t) that map one channel's weights to its value.

        At the samples these are the rows of (4). Between samples they follow the
        quintic spline through the samples of the series, not the series itself: a
        demonstrated window does not close on itself, so the series jumps at the wrap
        and rings near both ends. On a window of a 0.1 m movement sampled at 20 Hz the
        series was off by up to 20 mm and 2 m/s between samples, the spline by 0.01 mm
        and 1 mm/s.

        Parameters
        ----------
        steps : array_like
            Times in samples, from 0 to n_steps - 1.
        derivative : int
            Order of the derivative, 0 to 4, per sample^derivative.

        Returns
        -------
        ndarray, shape (..., T)
        """
        tau = as_floats(steps, "the steps")
        if tau.size == 0:
            raise SkillError("there is no step; give at least one.")
        check_number(
            derivative, "derivative", least=0, most=_SPLINE_DEGREE - 1, whole=True
        )
        if not np.all((tau >= -1e-9) & (tau <= self.n_steps - 1 + 1e-9)):
            raise SkillError(
                f"steps run from {np.min(tau)} to {np.max(tau)}; a window of "
                f"{self.n_steps} samples is defined from 0 to {self.n_steps - 1}."
            )
        return self._spline(tau, nu=derivative)

    @cached_property
    def _spline(self) -> BSpline:
        n = self.n_steps
        return make_interp_spline(
            np.arange(n), self.series(np.arange(n)), k=_SPLINE_DEGREE
        )

    def local_rows(self, step: float) -> Array:
        """Return `rows` and its first two derivatives at one time, fast.

        Parameters
        ----------
        step : float
            Time in samples, from 0 to n_steps - 1.

        Returns
        -------
        ndarray, shape (3, T)
            `rows(step, 0)`, `rows(step, 1)` and `rows(step, 2)`.
        """
        i = min(max(int(step), 0), self.n_steps - 2)
        u = step - i
        powers = np.array(
            [
                [1, u, u**2, u**3, u**4, u**5],
                [0, 1, 2 * u, 3 * u**2, 4 * u**3, 5 * u**4],
                [0, 0, 2, 6 * u, 12 * u**2, 20 * u**3],
            ]
        )
        return powers @ self.local_polynomial(i)

    def local_polynomial(self, interval: int) -> Array:
        """Return the polynomials of `rows` between two samples, shape (6, T).

        They are the coefficients of the powers 0 to 5 of the time in samples since the
        sample `interval`, an integer from 0 to n_steps - 2.
        """
        if interval not in self._polynomials:
            factorial = 1.0
            taylor = np.empty((_SPLINE_DEGREE + 1, self.n_steps))
            # The fifth derivative jumps at knots: take it inside the interval.
            for order in range(_SPLINE_DEGREE + 1):
                factorial *= max(order, 1)
                step = interval + (0.5 if order == _SPLINE_DEGREE else 0.0)
                taylor[order] = self._spline(step, nu=order) / factorial
            self._polynomials[interval] = taylor
        return self._polynomials[interval]

    def to_paper(self, weights: ArrayLike) -> Array:
        """Return the 2T weights (6) of each channel that the paper uses, from these.

        Parameters
        ----------
        weights : array_like, shape (..., D*T)

        Returns
        -------
        ndarray, shape (..., D*2T)
            [Re w~, Im w~] of each channel, with w~ as in (1).
        """
        w = self.by_channel(weights)
        n = self.n_steps
        spectrum = np.fft.fft(self.synthesize(weights), axis=-2)
        spectrum = np.swapaxes(spectrum, -1, -2)
        out = np.concatenate([spectrum.real, spectrum.imag], axis=-1)
        return out.reshape(*w.shape[:-2], -1, 2 * n).reshape(*w.shape[:-2], -1)


def closing_samples(n_steps: int) -> int:
    """Return the number of samples at the end of a closed window that are not played."""
    return int(_UNPLAYED * n_steps)


def close_windows(windows: Array) -> Array:
    """Blend the ends of windows (..., T, D) into their beginnings.

    The Fourier series of a window is periodic. If the last sample is far from the
    first, the series and its velocity ring between the samples, also far from the ends.
    Therefore the last samples, which are not played, are replaced by the smoothest
    periodic extension: the one with the smallest third differences.
    """
    out = np.array(windows)
    bridge = _bridge(windows.shape[-2])
    out[..., len(bridge.T) :, :] = bridge @ windows[..., : len(bridge.T), :]
    return out


@lru_cache
def _bridge(n_steps: int) -> Array:
    """Return the matrix (L, T - L) from the first samples of a window to the last L."""
    first = n_steps - round((1 - _KEPT) * closing_samples(n_steps))
    difference = np.eye(n_steps)
    for _ in range(3):
        difference = difference - np.roll(difference, 1, axis=0)
    out: Array = np.linalg.lstsq(difference[:, first:], -difference[:, :first])[0]
    out.setflags(write=False)
    return out
