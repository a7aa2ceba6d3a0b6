"""Gaussian mixture over Fourier weights, fitted in the span of the data."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import logsumexp

from fmp_drake.errors import SkillError
from fmp_drake.primitives.em import MixtureFit, fit_gaussians
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian

Progress = Callable[[str], None]

# What BIC chooses from.
_CANDIDATES = (1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80)
# Above this many windows and weights their products are decomposed instead of them.
_LARGE = 1000


def fit_mixture(
    weights: NDArray[np.float64],
    *,
    n_components: int | Literal["bic"],
    explained_variance: float,
    regularization: float,
    shrinkage: float = 0.0,
    seed: int,
    sample_weights: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
) -> tuple[NDArray[np.float64], tuple[LowRankGaussian, ...]]:
    """Fit the mixture (9) by EM, initialised by k-means.

    There are far fewer windows than weights, so EM runs on the coordinates of the
    windows in their leading principal directions. What those leave out, and
    the regulariser, is an isotropic variance in all directions.

    Parameters
    ----------
    weights : ndarray, shape (N, n)
        One row of Fourier weights per window.
    n_components : int or "bic"
        M; at most half the number of windows are used. "bic" takes the number with the
        least Bayesian information criterion.
    explained_variance : float
        Share of the variance that the principal directions keep, in (0, 1].
    regularization : float
        Variance added in every direction, in squared units of the weights.
    shrinkage : float
        Pseudo-counts of the components' shared covariance in each one's.
    seed : int
        Of the k-means initialisation.
    sample_weights : ndarray, shape (N,), optional
        How often each window counts, on average 1; all 1 where None.
    progress : callable, optional
        Told in words how far the fit is.

    Returns
    -------
    proportions : ndarray, shape (M,)
        The pi_j.
    components : tuple of LowRankGaussian
        M Gaussians over the n weights, sorted by falling proportion.
    """
    n_windows, n = weights.shape
    counts = np.ones(n_windows) if sample_weights is None else sample_weights
    mean = np.average(weights, axis=0, weights=counts)
    if progress is not None:
        progress(f"principal directions of {n_windows} windows of {n} weights")
    energy, directions = _principal_directions(
        (weights - mean) * np.sqrt(counts / counts.sum())[:, None]
    )
    total = float(energy.sum())
    if total > 0:
        kept = np.cumsum(energy) / total
        rank = 1 + int(np.searchsorted(kept, explained_variance * (1 - 1e-12)))
        rank = min(rank, len(energy))
        residual = float(energy[rank:].sum()) / max(n - rank, 1)
    else:
        rank, residual = 1, 0.0
    directions = directions[:rank]
    noise = regularization + residual
    samples = (weights - mean) @ directions.T

    def fitted(m: int) -> MixtureFit:
        return fit_gaussians(
            samples,
            sample_weights=counts,
            n_components=m,
            regularization=noise,
            shrinkage=shrinkage,
            seed=seed,
            progress=progress,
        )

    most = max(1, min(n_windows // 2, len(np.unique(samples, axis=0))))
    if n_components == "bic":
        fit = _least_bic(fitted, n_windows, rank, most)
    else:
        fit = fitted(min(n_components, most))
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


def log_densities(
    weights: NDArray[np.float64],
    proportions: NDArray[np.float64],
    components: tuple[LowRankGaussian, ...],
) -> NDArray[np.float64]:
    """Return the log density of the mixture (9) at weights (N, n), shape (N,)."""
    if len(proportions) != len(components):
        raise SkillError(
            f"{len(proportions)} proportions for {len(components)} components."
        )
    each = np.stack([c.log_density(weights) for c in components], axis=-1)
    out: NDArray[np.float64] = logsumexp(each + np.log(proportions), axis=-1)
    return out


def _principal_directions(
    centred: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return variances, falling, and directions (rows) of centred rows (N, n)."""
    n_rows, n = centred.shape
    if min(n_rows, n) <= _LARGE:
        _, singular, directions = np.linalg.svd(centred, full_matrices=False)
        return singular**2, directions
    if n <= n_rows:
        energy, columns = eigh(centred.T @ centred)
        return np.maximum(energy[::-1], 0), columns.T[::-1]
    energy, columns = eigh(centred @ centred.T)
    energy = np.maximum(energy[::-1], 0)
    # Directions of no variance are not determined by the products.
    rank = max(1, int(np.sum(energy > 1e-12 * energy[0])))
    directions = columns[:, ::-1][:, :rank].T @ centred
    directions /= np.maximum(np.linalg.norm(directions, axis=1), 1e-300)[:, None]
    return energy[:rank], directions


def _least_bic(
    fitted: Callable[[int], MixtureFit], n_windows: int, rank: int, most: int
) -> MixtureFit:
    """Try growing numbers of components until BIC has got worse twice running."""
    best, least, worse = None, np.inf, 0
    for m in (c for c in _CANDIDATES if c <= most):
        fit = fitted(m)
        free = m - 1 + m * rank + m * rank * (rank + 1) / 2
        bic = free * np.log(n_windows) - 2 * n_windows * fit.log_likelihood
        if bic < least:
            best, least, worse = fit, bic, 0
        else:
            worse += 1
            if worse == 2:
                break
    assert best is not None  # One component always fits.
    return best
