"""Gaussian process over time, conditioned on the recording."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.special import softmax

from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import (
    Array,
    Forecast,
    Method,
    diagonal,
    mixture_moments,
)

_MOST_POINTS = 1200
_MOST_POINTS_OF_LIKELIHOOD = 160
_PHASES = 48
# Logarithms of s, l, s_1, r_1 in periods, s_2, r_2 in periods, noise, p in estimated
# periods: bounds and start of the search.
_BOUNDS = np.log(
    [
        (0.3, 3.0),
        (0.2, 5.0),
        (0.01, 2.0),
        (0.5, 50.0),
        (1e-3, 1.0),
        (0.02, 0.5),
        (1e-4, 0.3),
        (0.9, 1.1),
    ]
)
_START = np.log([1.0, 0.8, 0.3, 3.0, 0.05, 0.1, 0.01, 1.0])


class RecordingGP(Method):
    """Quasi-periodic Gaussian process over time, conditioned on the longest recording.

    For each channel, in its own standard deviations::

        k(g) = s^2 c(g) + s_1^2 c(g) exp(-g^2 / (2 r_1^2)) + s_2^2 exp(-g^2 / (2 r_2^2))
               + noise^2 [g = 0],    c(g) = exp(-2 sin^2(pi g / p) / l^2)

    The first term, the mean cycle, never decays. The parameters maximise the
    likelihood of the recording. A prediction conditions on the whole recording and on
    the observed samples, whose phase is unknown: it averages over 48 phases, weighted by
    their evidence.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian processes for machine learning", MIT
    Press, 2006, section 5.4.3.
    """

    name = "GP, recording"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        period = movement_period(recordings)
        samples = np.concatenate(list(recordings))
        self._mean, self._scale = samples.mean(axis=0), samples.std(axis=0) + 1e-12
        longest = max(recordings, key=len)
        times = np.arange(float(len(longest)))
        values = (longest - self._mean) / self._scale
        step = max(1, -(-len(times) // _MOST_POINTS))
        times, values = times[::step], values[::step]
        start = slice(0, min(len(times), _MOST_POINTS_OF_LIKELIHOOD))
        units = np.ones(8)
        units[[3, 5, 7]] = period
        self._period = period

        def cost(logs: Array, y: Array) -> float:
            covariance = _kernel(np.exp(logs) * units, times[start], times[start])
            covariance += np.exp(2 * logs[6]) * np.eye(len(covariance))
            factor = cho_factor(covariance, lower=True)
            log_root = float(np.sum(np.log(np.diag(factor[0]))))
            return float(0.5 * y @ cho_solve(factor, y)) + log_root

        self._channels = []
        for y in values.T:
            fit = minimize(
                cost,
                _START,
                (y[start],),
                method="L-BFGS-B",
                bounds=_BOUNDS,
                options={"maxiter": 15},
            )
            parameters = np.exp(fit.x) * units
            covariance = _kernel(parameters, times, times)
            covariance += parameters[6] ** 2 * np.eye(len(times))
            factor = cho_factor(covariance, lower=True)
            self._channels.append((parameters, factor, cho_solve(factor, y)))
        self._times = times
        self._plans: dict[int, list[tuple[Array, Array]]] = {}

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D)."""
        k, d = past.shape
        if horizon not in self._plans:
            self._plans[horizon] = self._plan(k + horizon)
        y = (past - self._mean) / self._scale
        log_evidence = np.zeros(_PHASES)
        means = np.empty((_PHASES, horizon, d))
        variances = np.empty_like(means)
        for i, (mean, covariance) in enumerate(self._plans[horizon]):
            root = np.linalg.cholesky(covariance[:, :k, :k])
            error = y[:, i] - mean[:, :k]
            white = np.linalg.solve(root, error[..., None])[..., 0]
            gains = np.linalg.solve(root, covariance[:, :k, k:])
            log_evidence -= 0.5 * np.sum(white**2, axis=1)
            log_evidence -= np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            means[..., i] = mean[:, k:] + np.einsum("pk,pkh->ph", white, gains)
            prior = np.diagonal(covariance, axis1=1, axis2=2)[:, k:]
            variances[..., i] = prior - np.sum(gains**2, axis=1)
        value, covariances = mixture_moments(
            softmax(log_evidence), means, diagonal(variances)
        )
        return Forecast(
            values=value * self._scale + self._mean,
            covariances=covariances * np.multiply.outer(self._scale, self._scale),
        )

    def _plan(self, count: int) -> list[tuple[Array, Array]]:
        """Return means (P, n) and covariances (P, n, n) of n samples, for each channel.

        The samples are after the recording, at each of P phases.
        """
        plans = []
        for parameters, factor, solved in self._channels:
            period = parameters[7]
            begin = self._times[-1] + period * (1 + np.arange(_PHASES) / _PHASES)
            times = begin[:, None] + np.arange(count)
            across = _kernel(parameters, times.ravel(), self._times)
            mean = (across @ solved).reshape(_PHASES, count)
            half = np.linalg.solve(np.tril(factor[0]), across.T)
            half = half.T.reshape(_PHASES, count, -1)
            prior = _kernel(parameters, times[0], times[0])
            prior += parameters[6] ** 2 * np.eye(count)
            covariance = prior - half @ np.swapaxes(half, 1, 2)
            covariance += 1e-9 * np.eye(count)
            plans.append((mean, covariance))
        return plans


def _kernel(parameters: Array, a: Array, b: Array) -> Array:
    """Return the covariance between times a (n,) and b (m,) without noise, (n, m)."""
    s, length, s_1, r_1, s_2, r_2, _, period = parameters
    gaps = a[:, None] - b
    cycle = np.exp(-2 * (np.sin(np.pi * gaps / period) / length) ** 2)
    decay = s_1**2 * np.exp(-0.5 * (gaps / r_1) ** 2)
    out: Array = cycle * (s**2 + decay)
    out += s_2**2 * np.exp(-0.5 * (gaps / r_2) ** 2)
    return out
