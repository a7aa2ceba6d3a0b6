"""Kernelized movement primitives with a periodic kernel."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import softmax

from fmp_drake.experiments.baselines.alignment import align_periods, movement_period
from fmp_drake.experiments.baselines.method import Array, Forecast, Method, diagonal

_REFERENCES = 60  # Phases of the reference trajectory.
_CANDIDATES = 60  # Phases at which the observed samples may begin.
_LENGTHS = (0.15, 0.3, 0.6)  # Of the kernel: the best on left-out periods is chosen.
_REGULAR = 1.0  # Both regularisations, lambda of the mean and of the covariance.
_LEAST_VARIANCE = 1e-8


class PeriodicKMP(Method):
    """A kernelized movement primitive over the phase, with via-points.

    The reference distribution is mean and covariance of the aligned periods at 60
    phases; the kernel is exp(-2 sin^2((a - b) / 2) / l^2). Observed samples become
    via-points at the phases that fit best; predictions average over their phase,
    weighted by its evidence under the reference distribution.

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
        off = aligned.values - self._means
        covariances = np.einsum("ntd,nte->tde", off, off) / max(1, len(off) - 1)
        # With few periods neighbouring phases share their spread.
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
        chosen = np.flatnonzero(weights > 0.02)
        chosen = chosen if len(chosen) else np.array([int(np.argmax(weights))])
        weights = weights[chosen] / weights[chosen].sum()
        means = np.empty((len(chosen), horizon, d))
        inside = np.empty((len(chosen), horizon, d, d))
        for i, b in enumerate(begin[chosen]):
            means[i], inside[i] = self._adapted(b + steps, past)
        value = np.tensordot(weights, means, axes=1)
        off = means - value
        covariances = np.tensordot(weights, inside, axes=1)
        covariances += np.einsum("p,phd,phe->hde", weights, off, off)
        return Forecast(values=value, covariances=covariances)

    def _adapted(self, phases: Array, past: Array) -> tuple[Array, Array]:
        """Return mean (H, D) and covariances (H, D, D) with via-points at the past."""
        k, d = past.shape
        # A via-point replaces the reference at its phase.
        near = np.min(
            np.abs(np.angle(np.exp(1j * (self._phases[:, None] - phases[:k])))), axis=1
        )
        kept = near > 0.5 * self._step
        at = np.concatenate([self._phases[kept], phases[:k]])
        via = np.repeat(_LEAST_VARIANCE * np.eye(d)[None], k, axis=0)
        covariances = np.concatenate([self._covariances[kept], via])
        values = np.concatenate([self._means[kept], past])
        gram = np.kron(self._kernel(at, at, self.length_), np.eye(d))
        spread = block_diag(*covariances)
        # In units of the movement's variance the kernel has height 1.
        size = float(np.mean(np.var(self._means, axis=0)))
        factor = cho_factor(gram + _REGULAR * spread / size)
        across = np.kron(self._kernel(phases[k:], at, self.length_), np.eye(d))
        center = self._means.mean(axis=0)
        mean = across @ cho_solve(factor, (values - center).ravel())
        left = across @ cho_solve(factor, across.T)
        own = np.maximum(size * (1 - np.diagonal(left)), 0).reshape(-1, d)
        reference = np.interp(
            np.mod(phases[k:], 2 * np.pi), self._phases, np.arange(_REFERENCES)
        ).astype(int)
        inside = diagonal(own) + self._covariances[reference]
        return mean.reshape(-1, d) + center, inside

    def _evidence(self, phases: Array, past: Array) -> float:
        """Return the log density of samples at phases, under the reference."""
        index = np.rint(phases / (2 * np.pi) * _REFERENCES).astype(int) % _REFERENCES
        error = past - self._means[index]
        solved = np.linalg.solve(self._covariances[index], error[..., None])[..., 0]
        # Neighbouring samples err alike: together they count as one or two.
        return -0.5 * float(np.sum(error * solved)) / 4

    def _best_length(self, periods: Array) -> float:
        """Return the length that predicts half of the phases from the other half best."""
        mean = periods.mean(axis=0)
        mean = mean - mean.mean(axis=0)
        errors = []
        for length in _LENGTHS:
            gram = self._kernel(self._phases[::2], self._phases[::2], length)
            across = self._kernel(self._phases[1::2], self._phases[::2], length)
            weights = np.linalg.solve(gram + 1e-4 * np.eye(len(gram)), mean[::2])
            errors.append(float(np.sum((across @ weights - mean[1::2]) ** 2)))
        return _LENGTHS[int(np.argmin(errors))]

    @staticmethod
    def _kernel(a: Array, b: Array, length: float) -> Array:
        """Return the periodic kernel between phases a (n,) and b (m,), (n, m)."""
        gaps = np.subtract.outer(a, b)
        out: Array = np.exp(-2 * (np.sin(gaps / 2) / length) ** 2)
        return out
