"""Gaussian process with a periodic kernel."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    Array,
    Forecast,
    Method,
    diagonal,
    long_enough,
)
from fmp_drake.primitives import sliding_windows

# Ranges of s, l, r in periods, s_2, r_2 in periods, the noise and p in estimated periods,
# and starts of the search. Values are in standard deviations of a channel.
_RANGES = (
    (0.1, 10.0),
    (0.1, 10.0),
    (0.3, 100.0),
    (1e-4, 3.0),
    (0.02, 3.0),
    (1e-4, 1.0),
    (0.85, 1.15),
)
_STARTS = (
    (1.0, 1.0, 3.0, 0.05, 0.2, 3e-3, 1.0),
    (1.0, 2.0, 1.0, 0.3, 0.5, 3e-3, 1.0),
)


class PeriodicGP(Method):
    """Stationary Gaussian process with a slowly decaying periodic part.

    For each channel, in its own standard deviations (section 5.4.3 of Rasmussen and
    Williams, 2006)::

        k(g) = s^2 exp(-2 sin^2(pi g / p) / l^2 - g^2 / (2 r^2))
               + s_2^2 exp(-g^2 / (2 r_2^2)) + noise^2 [g = 0]

    All seven parameters maximise the likelihood of parts of 1.5 s. The likelihood has a
    maximum at every multiple of the period, so the search starts from an estimated one.
    The parts are treated as independent draws, so all of them need only one small matrix.

    Attributes
    ----------
    period_ : float
        The estimated period, samples.
    mean_, scale_ : ndarray, shape (D,)
        Mean and standard deviation of each channel.
    parameters_ : ndarray, shape (D, 7)
        s, l, r, s_2, r_2, noise and p of each channel; r, r_2 and p in samples.

    Examples
    --------
    >>> import numpy as np
    >>> path = np.sin(np.arange(150) * np.pi / 10)[:, None]
    >>> model = PeriodicGP()
    >>> model.fit([path])
    >>> forecast = model.predict(path[:10], 10)
    >>> bool(np.allclose(forecast.values, path[10:20], atol=0.05))
    True

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian processes for machine learning", MIT
    Press, 2006.
    """

    name = "GP, periodic"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        recordings = long_enough(recordings)
        self.period_ = movement_period(recordings)
        samples = np.concatenate(recordings)
        self.mean_, spread = samples.mean(axis=0), samples.std(axis=0)
        self.scale_ = np.where(spread > 1e-12, spread, 1.0)
        size = PAST + HORIZON
        parts = np.concatenate(
            [sliding_windows(y, n_steps=size, stride=size) for y in recordings]
        )
        scaled = (parts - self.mean_) / self.scale_
        units = np.ones(7)
        units[[2, 4, 6]] = self.period_
        bounds = np.log(_RANGES)

        def cost(logs: Array, values: Array) -> float:
            covariance = _covariance(np.exp(logs) * units, size)
            return -float(np.sum(_log_density(values, covariance)))

        parameters = []
        for channel in np.moveaxis(scaled, 2, 0):
            fits = [
                minimize(cost, start, (channel,), method="L-BFGS-B", bounds=bounds)
                for start in np.log(_STARTS)
            ]
            best = min(fits, key=lambda fit: float(fit.fun))
            parameters.append(np.exp(best.x) * units)
        self.parameters_ = np.array(parameters)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (K, D)."""
        scaled = (past - self.mean_) / self.scale_
        k, n_channels = scaled.shape
        values = np.empty((horizon, n_channels))
        variances = np.empty_like(values)
        for d, parameters in enumerate(self.parameters_):
            covariance = _covariance(parameters, k + horizon)
            across = covariance[:k, k:]
            gains = cho_solve(cho_factor(covariance[:k, :k]), across)
            values[:, d] = scaled[:, d] @ gains
            variances[:, d] = np.diag(covariance)[k:] - np.sum(gains * across, axis=0)
        return Forecast(
            values=values * self.scale_ + self.mean_,
            covariances=diagonal(variances * self.scale_**2),
        )


def _covariance(parameters: Array, count: int) -> Array:
    """Return the covariance of consecutive samples, noise included, (count, count)."""
    s, length, decay, s_2, decay_2, noise, period = parameters
    gaps = np.arange(count)[:, None] - np.arange(count)
    wave = np.sin(np.pi * gaps / period) / length
    out: Array = s**2 * np.exp(-2 * wave**2 - 0.5 * (gaps / decay) ** 2)
    out += s_2**2 * np.exp(-0.5 * (gaps / decay_2) ** 2) + noise**2 * np.eye(count)
    return out


def _log_density(values: Array, covariance: Array) -> Array:
    """Return the log density of windows (N, T) of zero mean, shape (N,)."""
    root = np.linalg.cholesky(covariance)
    whitened = np.linalg.solve(root, values.T)
    constant = np.log(np.diag(root)).sum() + 0.5 * len(root) * np.log(2 * np.pi)
    return np.asarray(-0.5 * np.sum(whitened**2, axis=0) - constant)
