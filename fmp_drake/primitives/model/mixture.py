"""Gaussian mixture over Fourier weights, fitted in the span of the data."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.linalg import cholesky, eigh, solve_triangular
from scipy.special import logsumexp

from fmp_drake.errors import SkillError
from fmp_drake.numeric import GREATEST, Array
from fmp_drake.primitives.data.windows import windows_of_all
from fmp_drake.primitives.model.basis import FourierBasis
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.mapping import MappingPlan

ComponentCount = int | Literal["automatic"]
Progress = Callable[[str], None]

MOST_COMPONENTS = 80
"""Greatest number of components where none is given."""
# The least number, and windows for each: with fewer windows the held-out density and
# prediction get worse.
_LEAST_COMPONENTS, _WINDOWS_EACH = 5, 7
# Confidence of the ellipsoid to which played weights are confined.
_CONFIDENCE = 0.99
# Above this number of windows and weights the Gram matrix is decomposed instead.
_LARGE = 1000
_LOG_2_PI = float(np.log(2 * np.pi))
_TINY = 10 * np.finfo(float).eps


@dataclass(frozen=True, kw_only=True, eq=False)
class MixtureFit:
    """A fitted mixture of M Gaussians in r dimensions.

    Attributes
    ----------
    proportions : ndarray, shape (M,)
    means : ndarray, shape (M, r)
    covariances : ndarray, shape (M, r, r)
        With the regulariser on their diagonals.
    """

    proportions: Array
    means: Array
    covariances: Array


def fit_mixture(
    weights: Array,
    *,
    n_components: ComponentCount,
    explained_variance: float,
    regularization: float,
    shrinkage: float = 0.0,
    seed: int,
    sample_weights: Array | None = None,
    progress: Progress | None = None,
) -> tuple[Array, tuple[LowRankGaussian, ...]]:
    """Fit the mixture (9) by EM, initialised by k-means.

    There are far fewer windows than weights, so EM runs on the coordinates of the
    windows in their leading principal directions. The variance in the other directions
    and the regulariser become an isotropic variance in all directions.

    Parameters
    ----------
    weights : ndarray, shape (N, n)
        One row of Fourier weights per window.
    n_components : int or "automatic"
        M; at most half the number of windows are used. "automatic" takes one for each 7
        windows, from 5 to 80.
    explained_variance : float
        Fraction of the variance that the principal directions keep, in (0, 1].
    regularization : float
        Variance added in every direction, in squared units of the weights.
    shrinkage : float
        Pseudo-counts of the shared covariance that is mixed into each component's.
    seed : int
        Of the k-means initialisation.
    sample_weights : ndarray, shape (N,), optional
        Weight of each window, on average 1; all 1 where None.
    progress : callable, optional
        Called with a sentence about each step of the fit.

    Returns
    -------
    proportions : ndarray, shape (M,)
        The pi_j.
    components : tuple of LowRankGaussian
        M Gaussians over the n weights, in order of decreasing proportion.
    """
    n_windows, n = weights.shape
    counts = np.ones(n_windows) if sample_weights is None else sample_weights
    mean = np.average(weights, axis=0, weights=counts)
    if progress is not None:
        progress(f"principal directions of {n_windows} windows of {n} weights")
    directions, residual = _principal_directions(
        (weights - mean) * np.sqrt(counts / counts.sum())[:, None], explained_variance
    )
    rank = len(directions)
    noise = regularization + residual
    samples = (weights - mean) @ directions.T

    if n_components == "automatic":
        n_components = n_windows // _WINDOWS_EACH
        n_components = min(max(n_components, _LEAST_COMPONENTS), MOST_COMPONENTS)
    most = max(1, min(n_windows // 2, _distinct(samples)))
    fit = fit_gaussians(
        samples,
        sample_weights=counts,
        n_components=min(n_components, most),
        regularization=noise,
        shrinkage=shrinkage,
        seed=seed,
        progress=progress,
    )
    order = np.argsort(-fit.proportions, kind="stable")
    components = []
    for j in order:
        variances, rotation = np.linalg.eigh(fit.covariances[j] - noise * np.eye(rank))
        keep = variances > 1e-6 * noise
        components.append(
            LowRankGaussian(
                mean=mean + fit.means[j] @ directions,
                basis=np.ascontiguousarray(directions.T @ rotation[:, keep]),
                variances=np.ascontiguousarray(variances[keep]),
                noise=float(noise),
            )
        )
    return fit.proportions[order], tuple(components)


def learn_continuation(
    recordings: Sequence[Array],
    *,
    n_steps: int,
    n_observed: int,
    tolerance: float,
    **options: Any,
) -> Callable[[Array], Array] | None:
    """Learn a mixture of recordings; return a function from a past to its continuation.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    n_steps : int
        T, samples in a window.
    n_observed : int
        K, samples of a past.
    tolerance : float
        lambda of (13).
    **options
        See `fit_mixture`.

    Returns
    -------
    callable or None
        From a past (K, D) to the rest of its window (T - K, D). None where the recordings
        have fewer than two windows.
    """
    stride = max(1, n_steps // 60)
    windows = windows_of_all(recordings, n_steps=n_steps, stride=stride)
    if len(windows) < 2:
        return None
    basis, channels = FourierBasis(n_steps), windows.shape[2]
    proportions, components = fit_mixture(basis.analyze(windows), **options)
    rows = np.einsum(
        "kt,cd->kcdt", basis.series(np.arange(n_observed)), np.eye(channels)
    )
    plan = MappingPlan(
        proportions,
        components,
        rows=rows.reshape(n_observed * channels, -1),
        tolerance=tolerance,
    )

    def play(past: Array) -> Array:
        mapping = plan.map(past.ravel())
        weights = components[mapping.component].confined(mapping.weights, _CONFIDENCE)
        return basis.synthesize(weights)[n_observed:]

    return play


def _principal_directions(
    centred: Array, explained_variance: float
) -> tuple[Array, float]:
    """Return the leading directions (r, n) of rows (N, n), and the residual variance.

    The residual variance is the mean over the n - r other directions.
    """
    n_rows, n = centred.shape
    if min(n_rows, n) <= _LARGE:
        _, singular, directions = np.linalg.svd(centred, full_matrices=False)
        rank, residual = _rank(singular**2, n, explained_variance)
        return directions[:rank], residual
    rows_are_fewer = n_rows < n
    energy, columns = eigh(
        centred @ centred.T if rows_are_fewer else centred.T @ centred
    )
    rank, residual = _rank(np.maximum(energy[::-1], 0), n, explained_variance)
    leading = columns[:, ::-1][:, :rank]
    if rows_are_fewer:
        # Their lengths are sqrt(energy); those of tiny energy are not orthogonal.
        leading = np.linalg.qr(centred.T @ leading)[0]
    return np.ascontiguousarray(leading.T), residual


def _rank(energy: Array, n: int, explained_variance: float) -> tuple[int, float]:
    """Return the number of directions to keep, and the mean variance in the others."""
    total = float(energy.sum())
    if total < 1 / GREATEST:
        return 1, total / n
    fraction = np.cumsum(energy) / total
    rank = 1 + int(np.searchsorted(fraction, explained_variance * (1 - 1e-12)))
    rank = min(rank, len(energy))
    return rank, float(energy[rank:].sum()) / max(n - rank, 1)


def _distinct(samples: Array) -> int:
    """Return the number of samples that differ by more than rounding."""
    greatest = float(np.max(np.abs(samples)))
    if greatest**2 < 1 / GREATEST:
        return 1
    return len(np.unique(np.round(samples / greatest, 9), axis=0))


def fit_gaussians(
    samples: Array,
    *,
    sample_weights: Array,
    n_components: int,
    regularization: float,
    shrinkage: float,
    seed: int,
    max_rounds: int = 200,
    tolerance: float = 1e-3,
    progress: Callable[[str], None] | None = None,
) -> MixtureFit:
    """Fit a mixture by EM, from the clusters of k-means.

    Parameters
    ----------
    samples : ndarray, shape (N, r)
    sample_weights : ndarray, shape (N,)
        Weight of each sample, positive.
    n_components : int
        M, at most N.
    regularization : float
        Variance that is added to the diagonal of every covariance.
    shrinkage : float
        Pseudo-counts of the covariance that all components share, which is mixed into
        each: the mode under an inverse Wishart prior. 0 is plain EM.
    seed : int
        Seed of k-means.
    max_rounds, tolerance
        EM ends where the mean log-likelihood grows by less than the tolerance.
    progress : callable, optional
        Called with a sentence about every round.
    """
    from sklearn.cluster import KMeans  # Slow to import.

    kmeans = KMeans(n_clusters=n_components, n_init=1, random_state=seed)
    labels = kmeans.fit(samples, sample_weight=sample_weights).labels_
    responsibilities = np.zeros((len(samples), n_components))
    responsibilities[np.arange(len(samples)), labels] = 1.0
    fit = _maximise(
        samples, sample_weights, responsibilities, regularization, shrinkage
    )
    previous = -np.inf
    for number in range(max_rounds):
        log_joint = log_gaussians(samples, fit.means, fit.covariances)
        log_joint += np.log(fit.proportions)
        log_density = logsumexp(log_joint, axis=1)
        responsibilities = np.exp(log_joint - log_density[:, None])
        now = float(np.average(log_density, weights=sample_weights))
        if progress is not None:
            progress(
                f"{n_components} components, round {number + 1}: mean "
                f"log-likelihood {now:.3f}"
            )
        fit = _maximise(
            samples, sample_weights, responsibilities, regularization, shrinkage
        )
        if abs(now - previous) < tolerance:
            break
        previous = now
    return fit


def log_gaussians(
    samples: Array,
    means: Array,
    covariances: Array,
) -> Array:
    """Return the log density of samples (N, r) under each Gaussian, (N, M)."""
    out = np.empty((len(samples), len(means)))
    for j, (mean, covariance) in enumerate(zip(means, covariances, strict=True)):
        try:
            lower = cholesky(covariance, lower=True)
        except np.linalg.LinAlgError:
            raise SkillError(
                "the windows vary too little in some directions beside others; choose "
                "a greater regularization, or a smaller explained_variance."
            ) from None
        z = solve_triangular(lower, (samples - mean).T, lower=True)
        log_det = 2 * np.sum(np.log(np.diag(lower)))
        out[:, j] = -0.5 * (np.sum(z**2, axis=0) + log_det)
    out -= 0.5 * samples.shape[1] * _LOG_2_PI
    return out


def _maximise(
    samples: Array,
    sample_weights: Array,
    responsibilities: Array,
    regularization: float,
    shrinkage: float,
) -> MixtureFit:
    counted = responsibilities * sample_weights[:, None]
    counts = counted.sum(axis=0) + _TINY
    means = counted.T @ samples / counts[:, None]
    scatters = np.empty((len(counts), samples.shape[1], samples.shape[1]))
    for j, mean in enumerate(means):
        delta = samples - mean
        scatters[j] = (counted[:, j] * delta.T) @ delta
    if shrinkage > 0:
        shared = scatters.sum(axis=0) / counts.sum()
        scatters += shrinkage * shared
    covariances = scatters / (counts + shrinkage)[:, None, None]
    diagonal = np.arange(samples.shape[1])
    covariances[:, diagonal, diagonal] += regularization
    return MixtureFit(
        proportions=counts / counts.sum(),
        means=means,
        covariances=covariances,
    )
