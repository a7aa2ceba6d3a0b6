"""Residual of a movement beside its mean cycle, with a phase-dependent covariance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.model.phase.autoregression import Autoregression
from fmp_drake.primitives.model.phase.cycle import FEW_CYCLES

_PHASES = 64
_WIDTH = 0.3
# Weight of the covariance over all phases, in cycles.
_PRIOR_CYCLES = 3.0
_ORDER = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """Residual L(phase) v: a stationary process v times a phase-dependent matrix.

    Attributes
    ----------
    factors : ndarray, shape (G, D, D)
        L at G equally spaced phases from 0; interpolated linearly.
    process : Autoregression
        Process v, whose covariance is about the identity.

    Examples
    --------
    >>> import numpy as np
    >>> phase = np.arange(2000) * 0.1
    >>> noise = np.random.default_rng(0).standard_normal((2000, 2))
    >>> residual = Residual.fit([phase], [noise * (2 + np.cos(phase))[:, None]])
    >>> wide, narrow = residual.factor(np.array([0.0, np.pi]))[:, 0, 0]
    >>> bool(wide > 2 * narrow)
    True
    """

    factors: NDArray[np.float64]
    process: Autoregression

    @classmethod
    def fit(
        cls,
        phases: Sequence[NDArray[np.float64]],
        residuals: Sequence[NDArray[np.float64]],
    ) -> "Residual":
        """Fit residuals (n, D) at phases (n,) of recordings."""
        phase, r = np.concatenate(phases), np.concatenate(residuals)
        grid = 2 * np.pi * np.arange(_PHASES) / _PHASES
        near = np.exp((np.cos(grid[:, None] - phase) - 1) / _WIDTH**2)
        near /= near.sum(axis=1, keepdims=True)
        local = np.einsum("gn,na,nb->gab", near, r, r, optimize=True)
        overall = r.T @ r / len(r)
        cycles = sum(float(p[-1] - p[0]) for p in phases) / (2 * np.pi)
        local = (cycles * local + _PRIOR_CYCLES * overall) / (cycles + _PRIOR_CYCLES)
        local += 1e-12 * np.eye(r.shape[1])
        variances, vectors = np.linalg.eigh(local)
        factors = np.einsum("gab,gb,gcb->gac", vectors, np.sqrt(variances), vectors)
        if cycles < FEW_CYCLES:
            process = Autoregression.fit_shared(residuals, order=_ORDER)
        else:
            shape_only = cls(factors=factors, process=_NO_PROCESS)
            whitened = [
                shape_only.standardised(p, x)
                for p, x in zip(phases, residuals, strict=True)
            ]
            process = Autoregression.fit(whitened, order=_ORDER)
        return cls(factors=np.ascontiguousarray(factors), process=process)

    def values(
        self, phase: NDArray[np.float64], v: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return L v at phases (..., n), for v (..., n, D)."""
        out: NDArray[np.float64] = (self.factor(phase) @ v[..., None])[..., 0]
        return out

    def standardised(
        self, phase: NDArray[np.float64], values: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the v (..., n, D) of residuals (..., n, D) at phases (..., n)."""
        out: NDArray[np.float64] = np.linalg.solve(
            self.factor(phase), values[..., None]
        )
        return out[..., 0]

    def shaped_covariance(
        self, phase: NDArray[np.float64], covariance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariance (n D, n D) of L v at phases (n,) for that of v."""
        factor = self.factor(phase)
        n, d, _ = factor.shape
        half = (factor @ covariance.reshape(n, d, n * d)).reshape(n * d, n * d)
        return (factor @ half.T.reshape(n, d, n * d)).reshape(n * d, n * d)

    def factor(self, phase: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return L at phases (...), shape (..., D, D)."""
        count = len(self.factors)
        place = np.mod(phase, 2 * np.pi) * (count / (2 * np.pi))
        before = np.floor(place).astype(int)
        ahead = (place - before)[..., None, None]
        return (1 - ahead) * self.factors[before % count] + ahead * self.factors[
            (before + 1) % count
        ]


_NO_PROCESS = Autoregression(
    coefficients=np.zeros((1, 1, 1)), innovation=np.ones((1, 1))
)
