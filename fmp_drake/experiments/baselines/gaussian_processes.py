"""Gaussian processes: periodic, over the recording, and on a delay embedding."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from scipy.special import softmax

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.alignment import movement_period
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    Forecast,
    Method,
    diagonal,
    long_enough,
    mixture_moments,
)
from fmp_drake.numeric import Array
from fmp_drake.primitives.data.windows import windows_of_all

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
# Greatest numbers of points of a prediction and of the likelihood, and number of phases.
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
_LEAST_POINTS = 8
# Candidates, from which the likelihood selects: length scales of the kernel, relative to
# the median distance of the past samples, and ratios of noise variance to signal variance.
_LENGTHS = (0.3, 0.6, 1.0, 1.7, 3.0, 6.0)
_RATIOS = np.logspace(-6, 1, 22)
_LEAST_VARIANCE = 1e-12


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
        parts = windows_of_all(recordings, n_steps=size, stride=size)
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
            cross = covariance[:k, k:]
            gains = cho_solve(cho_factor(covariance[:k, :k]), cross)
            values[:, d] = scaled[:, d] @ gains
            variances[:, d] = np.diag(covariance)[k:] - np.sum(gains * cross, axis=0)
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
        step = -(-len(times) // _MOST_POINTS)
        times, values = times[::step], values[::step]
        start = slice(_MOST_POINTS_OF_LIKELIHOOD)
        units = np.ones(8)
        units[[3, 5, 7]] = period

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
            cross = _kernel(parameters, times.ravel(), self._times)
            mean = (cross @ solved).reshape(_PHASES, count)
            half = np.linalg.solve(np.tril(factor[0]), cross.T)
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


class DelayGP(Method):
    """Gaussian process from the last samples to each of the next ones.

    Inputs are the last 10 samples of all channels (a delay embedding), outputs the 20
    following ones relative to the last. The squared-exponential kernel has one length
    scale for all outputs; scale and noise of every output maximise the likelihood.

    Attributes
    ----------
    length_ : float
        Length scale of the kernel, in standard deviations of the channels.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian processes for machine learning", MIT
    Press, 2006. J. Wang, D. Fleet, A. Hertzmann, "Gaussian process dynamical models for
    human motion", IEEE TPAMI 30(2), 2008.
    """

    name = "GP, delay embedding"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        samples = np.concatenate(list(recordings))
        self._mean, self._scale = samples.mean(axis=0), samples.std(axis=0) + 1e-12
        size = PAST + HORIZON
        windows = windows_of_all(recordings, n_steps=size)
        if len(windows) < _LEAST_POINTS:
            raise ExperimentError(
                f"there are {len(windows)} windows of {size} samples; expected at least "
                f"{_LEAST_POINTS}."
            )
        count = min(len(windows), _MOST_POINTS)
        indices = np.linspace(0, len(windows) - 1, count).astype(int)
        windows = (windows[indices] - self._mean) / self._scale
        self._inputs = windows[:, :PAST].reshape(count, -1)
        targets = windows[:, PAST:] - windows[:, PAST - 1 : PAST]
        targets = targets.reshape(count, -1)
        self._center = targets.mean(axis=0)
        targets = targets - self._center
        distances = cdist(self._inputs, self._inputs, "sqeuclidean")
        median = float(np.sqrt(np.median(distances[distances > 0])))
        best = -np.inf
        for relative in _LENGTHS:
            length = relative * median
            values, vectors = np.linalg.eigh(np.exp(-0.5 * distances / length**2))
            projected = (vectors.T @ targets) ** 2
            # Profile likelihood over the scale, for every ratio and output.
            spread = np.maximum(values, 0)[:, None] + _RATIOS
            scale = np.einsum("nr,no->ro", 1 / spread, projected) / count
            scale = np.maximum(scale, _LEAST_VARIANCE)
            log_likelihoods = (
                -0.5 * count * np.log(scale)
                - 0.5 * np.sum(np.log(spread), axis=0, keepdims=True).T
            )
            ratios = np.argmax(log_likelihoods, axis=0)
            total = float(np.sum(np.max(log_likelihoods, axis=0)))
            if total > best:
                best, self.length_ = total, length
                self._ratios, self._vectors = _RATIOS[ratios], vectors
                self._variances = scale[ratios, np.arange(targets.shape[1])]
                self._inverse = 1 / spread[:, ratios]
                self._gains = vectors @ (self._inverse * (vectors.T @ targets))

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        d = past.shape[1]
        scaled = (past - self._mean) / self._scale
        distances = cdist(scaled.reshape(1, -1), self._inputs, "sqeuclidean")
        row = np.exp(-0.5 * distances / self.length_**2)[0]
        mean = (row @ self._gains + self._center).reshape(HORIZON, d)[:horizon]
        explained = (row @ self._vectors) ** 2 @ self._inverse
        relative = np.maximum(1 - explained, 0) + self._ratios
        variances = (self._variances * relative).reshape(HORIZON, d)[:horizon]
        values = (scaled[-1] + mean) * self._scale + self._mean
        return Forecast(values=values, covariances=diagonal(variances * self._scale**2))
