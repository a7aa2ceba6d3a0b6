"""Expectation-maximisation for Gaussian mixtures with weighted samples."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from fmp_drake.errors import SkillError

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
    log_likelihood : float
        Weighted mean of the samples' log densities.
    """

    proportions: NDArray[np.float64]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]
    log_likelihood: float


def fit_gaussians(
    samples: NDArray[np.float64],
    *,
    sample_weights: NDArray[np.float64],
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
        Positive; how often each sample counts.
    n_components : int
        M, at most N.
    regularization : float
        Added to the diagonal of every covariance.
    shrinkage : float
        Pseudo-counts of the covariance that all components share, which is mixed into
        each: the mode under an inverse Wishart prior. 0 is plain EM.
    seed : int
        Of k-means.
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
            samples, sample_weights, responsibilities, regularization, shrinkage, now
        )
        if abs(now - previous) < tolerance:
            break
        previous = now
    return fit


def log_gaussians(
    samples: NDArray[np.float64],
    means: NDArray[np.float64],
    covariances: NDArray[np.float64],
) -> NDArray[np.float64]:
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
    samples: NDArray[np.float64],
    sample_weights: NDArray[np.float64],
    responsibilities: NDArray[np.float64],
    regularization: float,
    shrinkage: float,
    log_likelihood: float = -np.inf,
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
        log_likelihood=log_likelihood,
    )
