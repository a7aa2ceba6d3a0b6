"""Gaussian-process regression on a delay embedding."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    Array,
    Forecast,
    Method,
    diagonal,
)
from fmp_drake.primitives import sliding_windows

_MOST_POINTS = 1200
_LEAST_POINTS = 8
# Candidates, from which the likelihood selects: length scales of the kernel, relative to
# the median distance of the past samples, and ratios of noise variance to signal variance.
_LENGTHS = (0.3, 0.6, 1.0, 1.7, 3.0, 6.0)
_RATIOS = np.logspace(-6, 1, 22)
_LEAST_VARIANCE = 1e-12


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
        windows = np.concatenate(
            [sliding_windows(y, n_steps=size, stride=1) for y in recordings]
        )
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
