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

_MOST_POINTS = 1200
_LEAST_POINTS = 8
# Length scales of the kernel, relative to the median distance of the past samples, and
# ratios of the noise's to the signal's variance: the likeliest are chosen.
_LENGTHS = (0.3, 0.6, 1.0, 1.7, 3.0, 6.0)
_RATIOS = np.logspace(-6, 1, 22)
_LEAST_VARIANCE = 1e-12


class DelayGP(Method):
    """A Gaussian process from the last samples to each of the next ones.

    The input are the last 10 samples of all channels (a delay embedding), the outputs
    the 20 following ones relative to the last. The squared-exponential kernel has one
    length for all outputs; scale and noise of every output maximise the likelihood.

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
        view = np.lib.stride_tricks.sliding_window_view
        size = PAST + HORIZON
        windows = [view(y, size, axis=0) for y in recordings if len(y) >= size]
        count = sum(map(len, windows))
        if count < _LEAST_POINTS:
            raise ExperimentError(
                f"there are {count} windows of {size} samples; at least "
                f"{_LEAST_POINTS} are needed."
            )
        stacked = np.swapaxes(np.concatenate(windows), 1, 2)
        index = np.linspace(0, count - 1, min(count, _MOST_POINTS)).astype(int)
        stacked = (stacked[index] - self._mean) / self._scale
        self._inputs = stacked[:, :PAST].reshape(len(index), -1)
        ahead = stacked[:, PAST:] - stacked[:, PAST - 1 : PAST]
        targets = ahead.reshape(len(index), -1)
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
            scale = np.einsum("nr,no->ro", 1 / spread, projected) / len(index)
            scale = np.maximum(scale, _LEAST_VARIANCE)
            fit = (
                -0.5 * len(index) * np.log(scale)
                - 0.5 * np.sum(np.log(spread), axis=0, keepdims=True).T
            )
            ratios = np.argmax(fit, axis=0)
            total = float(np.sum(np.max(fit, axis=0)))
            if total > best:
                best, self.length_ = total, length
                picked = np.arange(targets.shape[1])
                self._ratios, self._vectors = _RATIOS[ratios], vectors
                self._variances = scale[ratios, picked]
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
        left = np.maximum(1 - explained, 0) + self._ratios
        variances = (self._variances * left).reshape(HORIZON, d)[:horizon]
        values = (scaled[-1] + mean) * self._scale + self._mean
        return Forecast(values=values, covariances=diagonal(variances * self._scale**2))
