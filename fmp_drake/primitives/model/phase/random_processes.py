"""Stochastic processes of a phase model: phase velocity and residual."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_lyapunov, solve_toeplitz

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.model.phase.cycle import FEW_CYCLES, count_cycles

# Autoregression: relative ridge, and greatest radius of its eigenvalues.
_RIDGE = 1e-6
_MOST_RADIUS = 0.995
_VELOCITY_ORDER, _RESIDUAL_ORDER = 4, 6
# Fraction of a recording, half of it at either end, that is tapered.
_TAPERED_FRACTION = 0.3
# Fraction of the windows, those with the greatest phase noise, that are left out.
_OUTLIER_FRACTION = 0.05
# Sufficient number of whole windows per sample of a window.
_SUFFICIENT_WINDOWS = 5
# Greatest deviation of an initial phase velocity, in standard deviations.
_MOST_DEVIATION = 2.5
# Residual: phases of the factors, width of the kernel over phases, rad, and weight of the
# covariance over all phases, in cycles.
_GRID_PHASES = 64
_KERNEL_WIDTH = 0.3
_PRIOR_CYCLES = 3.0
# Variance of a channel relative to the greatest below which it hardly differs from the cycle.
_LEAST_VARIANCE = 1e-6


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

    coefficients: Array
    innovation: Array

    @classmethod
    def fit(cls, recordings: Sequence[Array], *, order: int) -> "Autoregression":
        """Fit recordings (n, D) of about unit variance and zero mean."""
        regressors, targets = [], []
        for v in recordings:
            past = [v[order - k : len(v) - k] for k in range(1, order + 1)]
            regressors.append(np.concatenate(past, axis=1))
            targets.append(v[order:])
        x, y = np.concatenate(regressors), np.concatenate(targets)
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
    def fit_separately(
        cls, recordings: Sequence[Array], *, order: int
    ) -> "Autoregression":
        """Fit a process of unit variance to each channel of recordings (n, D).

        It has `order` coefficients for each. D times as many would explain few samples
        nearly exactly, and the process would hardly vary. The Yule-Walker equations keep the
        variance; the ends of recordings are tapered, because they would otherwise look
        like jumps.
        """
        from scipy.signal.windows import tukey  # Slow to import.

        d = recordings[0].shape[1]
        products = np.zeros((order + 1, d))
        for v in recordings:
            # The rest keeps its weight: L is fitted to all of it.
            x = v * tukey(len(v), _TAPERED_FRACTION)[:, None]
            for lag in range(min(order + 1, len(v))):
                products[lag] += np.sum(x[lag:] * x[: len(v) - lag], axis=0)
        correlation = products / np.maximum(products[0], 1e-300)
        correlation[0] = 1 + _RIDGE
        coefficients, innovation = np.zeros((order, d, d)), np.zeros((d, d))
        for i, c in enumerate(correlation.T):
            coefficients[:, i, i] = a = solve_toeplitz(c[:-1], c[1:])
            innovation[i, i] = c[0] - a @ c[1:]
        return cls(coefficients=coefficients, innovation=innovation)

    def autocovariance(self, count: int) -> Array:
        """Return E[v_(t+k) v_t'] of the lags k = 0 to count - 1, (count, D, D)."""
        d = len(self.innovation)
        companion, stationary = _companion(self.coefficients), self._stationary
        out = np.empty((count, d, d))
        for lag in range(count):
            out[lag] = stationary[:d, :d]
            stationary = companion @ stationary
        return out

    def covariance(self, steps: Indices) -> Array:
        """Return E[v_t v_u'] at steps (n,), shape (n, D, n, D)."""
        lags = steps[:, None] - steps
        later = self.autocovariance(int(np.ptp(steps)) + 1)[np.abs(lags)]
        earlier = np.swapaxes(later, -1, -2)
        both = np.where((lags >= 0)[..., None, None], later, earlier)
        return np.swapaxes(both, 1, 2)

    def sample(self, normals: Array, *, past: Array | None = None) -> Array:
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
    def _stationary(self) -> Array:
        """Return the covariance of (v_t, ..., v_(t-p+1)), shape (p D, p D)."""
        companion = _companion(self.coefficients)
        d = len(self.innovation)
        drive = np.zeros_like(companion)
        drive[:d, :d] = self.innovation
        out = solve_discrete_lyapunov(companion, drive)
        return (out + out.T) / 2


@compiled
def _run(values: Array, coefficients: Array) -> None:
    """Add the regression on the previous p values to values (S, n, D) after the first p."""
    p, d, _ = coefficients.shape
    for s in range(len(values)):
        for t in range(p, values.shape[1]):
            for k in range(p):
                for i in range(d):
                    for j in range(d):
                        values[s, t, i] += (
                            coefficients[k, i, j] * values[s, t - 1 - k, j]
                        )


def _root(covariance: Array) -> Array:
    """Return a matrix R with R R' the covariance."""
    variances, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(variances, 0))


def _companion(coefficients: Array) -> Array:
    p, d, _ = coefficients.shape
    out = np.eye(p * d, k=-d)
    out[:d] = np.concatenate(list(coefficients), axis=1)
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseVelocity:
    """Increments of the phase from sample to sample.

    Attributes
    ----------
    mean : float
        rad per sample.
    spread : float
        Standard deviation, rad per sample.
    process : Autoregression
        Deviations from the mean, in standard deviations.

    Examples
    --------
    >>> import numpy as np
    >>> velocity = PhaseVelocity.fit([0.1 * np.arange(50)])
    >>> round(velocity.mean, 3), round(velocity.spread, 3)
    (0.1, 0.0)
    """

    mean: float
    spread: float
    process: Autoregression

    @classmethod
    def fit(cls, phases: Sequence[Array]) -> "PhaseVelocity":
        """Fit the unwrapped phases (n,) of recordings."""
        increments = [np.diff(p) for p in phases]
        mean = float(np.mean(np.concatenate(increments)))
        spread = max(float(np.std(np.concatenate(increments))), 1e-9)
        process = Autoregression.fit(
            [(i[:, None] - mean) / spread for i in increments], order=_VELOCITY_ORDER
        )
        return cls(mean=mean, spread=spread, process=process)

    def sample(self, normals: Array, *, reference_step: int) -> Array:
        """Return sampled phases (S, n) that are 0 at the sample `reference_step`.

        Parameters
        ----------
        normals : ndarray, shape (S, p + n - 1)
            Standard normals; p is the order of the process.
        reference_step : int
        """
        phase = self._phases(self.process.sample(normals[..., None]))
        return phase - phase[:, reference_step, None]

    def continued(self, normals: Array, start: Array) -> Array:
        """Return sampled phases (S, k + n) that continue known ones, (k,).

        Parameters
        ----------
        normals : ndarray, shape (S, p + n)
        start : ndarray, shape (k,)
        """
        past = (np.diff(start) - self.mean) / self.spread
        past = np.clip(past, -_MOST_DEVIATION, _MOST_DEVIATION)[None, :, None]
        past = np.repeat(past, len(normals), axis=0)
        increments = self._phases(self.process.sample(normals[..., None], past=past))
        known_phases = np.repeat(start[None], len(normals), axis=0)
        return np.concatenate([known_phases, start[-1] + increments[:, 1:]], axis=1)

    def _phases(self, deviations: Array) -> Array:
        """Integrate deviations (S, n, 1) of the velocity to phases (S, n + 1) from 0."""
        increments = self.mean + self.spread * deviations[..., 0]
        phase = np.zeros((len(increments), increments.shape[1] + 1))
        np.cumsum(increments, axis=1, out=phase[:, 1:])
        return phase

    def phase_noise(self, count: int) -> Array:
        """Return the covariance (n, n) of n phases relative to the first."""
        velocities = self.process.covariance(np.arange(count - 1))[:, 0, :, 0]
        out = np.zeros((count, count))
        out[1:, 1:] = self.spread**2 * np.cumsum(np.cumsum(velocities, axis=0), axis=1)
        return out


def phase_covariance(
    phases: Sequence[Array],
    velocity: float,
    *,
    count: int,
    reference_step: int,
) -> Array:
    """Return the covariance of the phase noise in a window, shape (count, count).

    The phase noise is psi(tau) = phase(t + tau) - phase(t + r) - velocity (tau - r)
    with r the `reference_step`. E[psi psi'] is over all windows of `count` samples
    except the few with the greatest noise. If there are few whole windows, the
    available samples of windows that the end of a recording cuts are used as well, and
    the process of the velocity with the weight of half a window.
    """
    whole_windows = sum(max(0, len(p) - count + 1) for p in phases)
    has_few_windows = whole_windows < _SUFFICIENT_WINDOWS * count
    missing_samples = count - 2 - reference_step if has_few_windows else 0
    padding = np.full(missing_samples, np.nan)
    windows = [
        np.lib.stride_tricks.sliding_window_view(np.concatenate([p, padding]), count)
        for p in phases
        if len(p) + len(padding) >= count
    ]
    psi, steps = np.concatenate(windows), np.arange(count) - reference_step
    psi = psi - psi[:, reference_step, None] - velocity * steps
    sizes = np.nanmean(psi**2, axis=1)
    psi = psi[sizes <= np.quantile(sizes, 1 - _OUTLIER_FRACTION)]
    is_known = np.isfinite(psi).astype(float)
    psi = np.where(is_known > 0, psi, 0.0)
    squares, counts = psi.T @ psi, is_known.T @ is_known
    if has_few_windows:
        # Entries without any window follow from the process of the velocity.
        process = PhaseVelocity.fit(phases).phase_noise(count)
        row = process[reference_step]
        process = process - row - row[:, None] + row[reference_step]
        squares, counts = squares + count / 2 * process, counts + count / 2
    out = squares / np.maximum(counts, 1.0)
    variances, vectors = np.linalg.eigh(out)
    return (vectors * np.maximum(variances, 0.0)) @ vectors.T


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

    factors: Array
    process: Autoregression

    @classmethod
    def fit(
        cls,
        phases: Sequence[Array],
        residuals: Sequence[Array],
    ) -> "Residual":
        """Fit residuals (n, D) at phases (n,) of recordings."""
        phase, r = np.concatenate(phases), np.concatenate(residuals)
        grid = 2 * np.pi * np.arange(_GRID_PHASES) / _GRID_PHASES
        kernel = np.exp((np.cos(grid[:, None] - phase) - 1) / _KERNEL_WIDTH**2)
        kernel /= kernel.sum(axis=1, keepdims=True)
        local = np.einsum("gn,na,nb->gab", kernel, r, r, optimize=True)
        overall = r.T @ r / len(r)
        cycles = count_cycles(phases)
        local = (cycles * local + _PRIOR_CYCLES * overall) / (cycles + _PRIOR_CYCLES)
        local += 1e-12 * np.eye(r.shape[1])
        variances, vectors = np.linalg.eigh(local)
        factors = np.einsum("gab,gb,gcb->gac", vectors, np.sqrt(variances), vectors)
        process = Autoregression.fit_separately(residuals, order=_RESIDUAL_ORDER)
        residual = cls(factors=np.ascontiguousarray(factors), process=process)
        if cycles < FEW_CYCLES:
            return residual
        whitened = [
            residual.standardised(p, x) for p, x in zip(phases, residuals, strict=True)
        ]
        # A channel that hardly differs from the cycle, such as the height of a path on a
        # board, says nothing about the others. It keeps the shared process.
        size = np.diag(overall)
        varies = (size == 0) | (size > _LEAST_VARIANCE * np.max(size))
        own = Autoregression.fit(
            [v[:, varies] for v in whitened], order=_RESIDUAL_ORDER
        )
        among = (..., *np.ix_(varies, varies))
        coefficients, innovation = map(
            np.copy, (process.coefficients, process.innovation)
        )
        coefficients[among], innovation[among] = own.coefficients, own.innovation
        process = Autoregression(coefficients=coefficients, innovation=innovation)
        return replace(residual, process=process)

    def values(self, phase: Array, v: Array) -> Array:
        """Return L v at phases (..., n), for v (..., n, D)."""
        return (self.factor(phase) @ v[..., None])[..., 0]

    def standardised(self, phase: Array, values: Array) -> Array:
        """Return the v (..., n, D) of residuals (..., n, D) at phases (..., n)."""
        return np.linalg.solve(self.factor(phase), values[..., None])[..., 0]

    def shaped_covariance(self, phase: Array, covariance: Array) -> Array:
        """Return the covariance (..., n D, n D) of L v at phases (..., n) for that of v."""
        factor = self.factor(phase)
        *m, n, d, _ = factor.shape
        half = (factor @ covariance.reshape(n, d, n * d)).reshape(*m, n * d, n * d)
        return (factor @ half.mT.reshape(*m, n, d, n * d)).reshape(*m, n * d, n * d)

    def factor(self, phase: Array) -> Array:
        """Return L at phases (...), shape (..., D, D)."""
        count = len(self.factors)
        place = np.mod(phase, 2 * np.pi) * (count / (2 * np.pi))
        lower = np.floor(place).astype(int)
        ratio = (place - lower)[..., None, None]
        return (1 - ratio) * self.factors[lower % count] + ratio * self.factors[
            (lower + 1) % count
        ]
