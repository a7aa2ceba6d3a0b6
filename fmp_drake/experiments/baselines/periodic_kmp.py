"""Kernelized movement primitives with a periodic kernel."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import softmax

from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import (
    Forecast,
    Method,
    diagonal,
    mixture_moments,
)
from fmp_drake.numeric import Array

# Phases of the reference trajectory, and phases at which the observed samples may begin.
_REFERENCES, _CANDIDATES = 60, 60
# Candidates for the length scale of the kernel.
_LENGTHS = (0.15, 0.3, 0.6)
# lambda of the mean and of the covariance.
_REGULARISATION = 1.0
_LEAST_VARIANCE = 1e-8


class PeriodicKMP(Method):
    """Kernelized movement primitive over the phase, with via-points.

    The reference distribution is mean and covariance of the aligned periods at 60
    phases; the kernel is exp(-2 sin^2((a - b) / 2) / l^2). Observed samples become
    via-points. Predictions average over the phase at which they begin, weighted by its
    evidence under the reference distribution.

    References
    ----------
    Y. Huang, L. Rozo, J. Silvério, D. G. Caldwell, "Kernelized movement primitives",
    International Journal of Robotics Research 38(7), 2019.
    """

    name = "periodic KMP"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        aligned = align_periods(
            list(recordings), period=movement_period(recordings), n_steps=_REFERENCES
        )
        self._step = 2 * np.pi / float(aligned.durations.mean())
        self._phases = 2 * np.pi * np.arange(_REFERENCES) / _REFERENCES
        self._means = aligned.values.mean(axis=0)
        residuals = aligned.values - self._means
        covariances = np.einsum("ntd,nte->tde", residuals, residuals)
        covariances /= max(1, len(residuals) - 1)
        # Few periods give noisy covariances: they are averaged over neighbouring phases.
        kernel = self._kernel(self._phases, self._phases, 0.3)
        kernel /= kernel.sum(axis=1, keepdims=True)
        d = self._means.shape[1]
        self._covariances = np.einsum("ts,sde->tde", kernel, covariances)
        self._covariances += _LEAST_VARIANCE * np.eye(d)
        self.length_ = self._best_length(aligned.values)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D)."""
        k, d = past.shape
        begin = 2 * np.pi * np.arange(_CANDIDATES) / _CANDIDATES
        steps = self._step * np.arange(k + horizon)
        log_evidence = np.array([self._evidence(b + steps[:k], past) for b in begin])
        weights = softmax(log_evidence)
        is_likely = (weights > 0.02) | (weights == weights.max())
        weights = weights[is_likely] / weights[is_likely].sum()
        means = np.empty((len(weights), horizon, d))
        covariances = np.empty((len(weights), horizon, d, d))
        for i, b in enumerate(begin[is_likely]):
            means[i], covariances[i] = self._conditioned(b + steps, past)
        value, covariance = mixture_moments(weights, means, covariances)
        return Forecast(values=value, covariances=covariance)

    def _conditioned(self, phases: Array, past: Array) -> tuple[Array, Array]:
        """Return mean (H, D) and covariances (H, D, D), with `past` as via-points."""
        k, d = past.shape
        # A via-point replaces the reference at its phase.
        differences = np.angle(np.exp(1j * (self._phases[:, None] - phases[:k])))
        is_free = np.min(np.abs(differences), axis=1) > 0.5 * self._step
        nodes = np.concatenate([self._phases[is_free], phases[:k]])
        via_covariances = np.repeat(_LEAST_VARIANCE * np.eye(d)[None], k, axis=0)
        noise = block_diag(*self._covariances[is_free], *via_covariances)
        values = np.concatenate([self._means[is_free], past])
        gram = np.kron(self._kernel(nodes, nodes, self.length_), np.eye(d))
        # In units of the movement's variance the kernel has height 1.
        height = float(np.mean(np.var(self._means, axis=0)))
        factor = cho_factor(gram + _REGULARISATION * noise / height)
        cross = np.kron(self._kernel(phases[k:], nodes, self.length_), np.eye(d))
        center = self._means.mean(axis=0)
        mean = cross @ cho_solve(factor, (values - center).ravel())
        explained = np.diagonal(cross @ cho_solve(factor, cross.T))
        variances = np.maximum(height * (1 - explained), 0).reshape(-1, d)
        indices = np.interp(
            np.mod(phases[k:], 2 * np.pi), self._phases, np.arange(_REFERENCES)
        ).astype(int)
        covariances = diagonal(variances) + self._covariances[indices]
        return mean.reshape(-1, d) + center, covariances

    def _evidence(self, phases: Array, past: Array) -> float:
        """Return the log density of samples at phases under the reference distribution."""
        index = np.rint(phases / (2 * np.pi) * _REFERENCES).astype(int) % _REFERENCES
        error = past - self._means[index]
        solved = np.linalg.solve(self._covariances[index], error[..., None])[..., 0]
        # The errors of neighbouring samples are correlated: four count as one sample.
        return -0.5 * float(np.sum(error * solved)) / 4

    def _best_length(self, periods: Array) -> float:
        """Return the length scale that best predicts half of the phases from the others."""
        mean = periods.mean(axis=0)
        mean = mean - mean.mean(axis=0)
        errors = []
        for length in _LENGTHS:
            gram = self._kernel(self._phases[::2], self._phases[::2], length)
            cross = self._kernel(self._phases[1::2], self._phases[::2], length)
            weights = np.linalg.solve(gram + 1e-4 * np.eye(len(gram)), mean[::2])
            errors.append(float(np.sum((cross @ weights - mean[1::2]) ** 2)))
        return _LENGTHS[int(np.argmin(errors))]

    @staticmethod
    def _kernel(a: Array, b: Array, length: float) -> Array:
        """Return the periodic kernel between phases a (n,) and b (m,), (n, m)."""
        gaps = np.subtract.outer(a, b)
        out: Array = np.exp(-2 * (np.sin(gaps / 2) / length) ** 2)
        return out
