"""Stationary vector autoregressions."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov, solve_toeplitz

from fmp_drake.compiled import compiled

_RIDGE = 1e-6
_MOST_RADIUS = 0.995


@dataclass(frozen=True, kw_only=True, eq=False)
class Autoregression:
    """v_t = A_1 v_(t-1) + ... + A_p v_(t-p) + innovation, stationary.

    Attributes
    ----------
    coefficients : ndarray, shape (p, D, D)
        A_1 to A_p.
    innovation : ndarray, shape (D, D)
        Covariance of the innovation.

    Examples
    --------
    >>> import numpy as np
    >>> process = Autoregression(
    ...     coefficients=np.full((1, 1, 1), 0.5), innovation=np.full((1, 1), 0.75)
    ... )
    >>> process.autocovariance(3).ravel()
    array([1.  , 0.5 , 0.25])
    """

    coefficients: NDArray[np.float64]
    innovation: NDArray[np.float64]

    @classmethod
    def fit(
        cls, recordings: Sequence[NDArray[np.float64]], *, order: int
    ) -> "Autoregression":
        """Fit recordings (n, D) of about unit variance and zero mean."""
        lagged, after = [], []
        for v in recordings:
            past = [v[order - k : len(v) - k] for k in range(1, order + 1)]
            lagged.append(np.concatenate(past, axis=1))
            after.append(v[order:])
        x, y = np.concatenate(lagged), np.concatenate(after)
        gram = x.T @ x + _RIDGE * len(x) * np.eye(x.shape[1])
        solution = np.linalg.solve(gram, x.T @ y)
        errors = y - x @ solution
        d = y.shape[1]
        coefficients = np.swapaxes(solution.reshape(order, d, d), 1, 2)
        radius = np.max(np.abs(np.linalg.eigvals(_companion(coefficients))))
        decay = min(1.0, _MOST_RADIUS / max(float(radius), 1e-12))
        coefficients = coefficients * decay ** np.arange(1, order + 1)[:, None, None]
        innovation = errors.T @ errors / len(errors) + 1e-12 * np.eye(d)
        return cls(
            coefficients=np.ascontiguousarray(coefficients), innovation=innovation
        )

    @classmethod
    def fit_shared(
        cls, recordings: Sequence[NDArray[np.float64]], *, order: int
    ) -> "Autoregression":
        """Fit one process of unit variance, independent in each channel, to recordings (n, D).

        It has `order` coefficients instead of D^2 times as many, which few samples would
        explain nearly exactly: their process hardly varies. The Yule-Walker equations keep
        the variance; recordings are tapered, as their ends would otherwise look like jumps.
        """
        products = np.zeros(order + 1)
        for v in recordings:
            taper = np.sin(np.pi * (np.arange(len(v)) + 0.5) / len(v)) ** 2
            x = v * taper[:, None]
            for lag in range(min(order + 1, len(v))):
                products[lag] += np.sum(x[lag:] * x[: len(v) - lag])
        correlation = products / max(products[0], 1e-300)
        correlation[0] = 1 + _RIDGE
        a = solve_toeplitz(correlation[:-1], correlation[1:])
        unit = np.eye(recordings[0].shape[1])
        return cls(
            coefficients=np.multiply.outer(a, unit),
            innovation=float(correlation[0] - a @ correlation[1:]) * unit,
        )

    def autocovariance(self, count: int) -> NDArray[np.float64]:
        """Return E[v_(t+k) v_t'] of the lags k = 0 to count - 1, (count, D, D)."""
        d = len(self.innovation)
        companion, stationary = _companion(self.coefficients), self._stationary
        out = np.empty((count, d, d))
        for lag in range(count):
            out[lag] = stationary[:d, :d]
            stationary = companion @ stationary
        return out

    def covariance(self, steps: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return E[v_t v_u'] at steps (n,), shape (n, D, n, D)."""
        lags = steps[:, None] - steps
        later = self.autocovariance(int(np.ptp(steps)) + 1)[np.abs(lags)]
        earlier = np.swapaxes(later, -1, -2)
        both = np.where((lags >= 0)[..., None, None], later, earlier)
        return np.swapaxes(both, 1, 2)

    def sample(
        self, normals: NDArray[np.float64], *, past: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return samples (S, n, D) of the process from standard normals (S, p + n, D).

        They continue values `past`, (S, k, D), where these are given. If k < p, the first
        of them is repeated.
        """
        p, d, _ = self.coefficients.shape
        out = normals @ _root(self.innovation).T
        if past is None:
            # The state of the companion form holds the newest sample first.
            begin = normals[:, :p].reshape(-1, p * d) @ _root(self._stationary).T
            out[:, :p] = begin.reshape(-1, p, d)[:, ::-1]
        else:
            newest = np.arange(past.shape[1] - p, past.shape[1])
            out[:, :p] = past[:, np.maximum(newest, 0)]
        _run(out, self.coefficients)
        return out[:, p:]

    @cached_property
    def _stationary(self) -> NDArray[np.float64]:
        """Return the covariance of (v_t, ..., v_(t-p+1)), shape (p D, p D)."""
        companion = _companion(self.coefficients)
        d = len(self.innovation)
        drive = np.zeros_like(companion)
        drive[:d, :d] = self.innovation
        out: NDArray[np.float64] = solve_discrete_lyapunov(companion, drive)
        return (out + out.T) / 2


@compiled
def _run(values: NDArray[np.float64], coefficients: NDArray[np.float64]) -> None:
    """Add the regression on the p values before to all values (S, n, D) but the first p."""
    p, d, _ = coefficients.shape
    for s in range(len(values)):
        for t in range(p, values.shape[1]):
            for k in range(p):
                for i in range(d):
                    for j in range(d):
                        values[s, t, i] += (
                            coefficients[k, i, j] * values[s, t - 1 - k, j]
                        )


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a matrix R with R R' the covariance."""
    variances, vectors = np.linalg.eigh(covariance)
    out: NDArray[np.float64] = vectors * np.sqrt(np.maximum(variances, 0))
    return out


def _companion(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
    p, d, _ = coefficients.shape
    out = np.eye(p * d, k=-d)
    out[:d] = np.concatenate(list(coefficients), axis=1)
    return out
