"""Gaussian mixture over Fourier weights, fitted in the span of the data."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import logsumexp

from fmp_drake.errors import SkillError
from fmp_drake.numeric import GREATEST
from fmp_drake.primitives.model.em import MixtureFit, fit_gaussians
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.parameters import ComponentCount

Progress = Callable[[str], None]

MOST_COMPONENTS = 80
"""That are taken where no number is given."""
# And the least, and the windows of each: with fewer of them the next minute is less likely,
# and the next second predicted worse.
_LEAST_COMPONENTS, _WINDOWS_EACH = 5, 7
# What BIC chooses from.
_CANDIDATES = (1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80)
# Above this many windows and weights their products are decomposed instead of them.
_LARGE = 1000


def fit_mixture(
    weights: NDArray[np.float64],
    *,
    n_components: ComponentCount,
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
    n_components : int, "automatic" or "bic"
        M; at most half the number of windows are used. "automatic" takes one for each 7
        windows, from 5 to 80, "bic" the number with the least Bayesian information
        criterion.
    explained_variance : float
        Fraction of the variance that the principal directions keep, in (0, 1].
    regularization : float
        Variance added in every direction, in squared units of the weights.
    shrinkage : float
        Pseudo-counts of the components' shared covariance in each one's.
    seed : int
        Of the k-means initialisation.
    sample_weights : ndarray, shape (N,), optional
        How often each window counts, on average 1; all 1 where None.
    progress : callable, optional
        Called with a sentence about each step of the fit.

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
    directions, residual = _principal_directions(
        (weights - mean) * np.sqrt(counts / counts.sum())[:, None], explained_variance
    )
    rank = len(directions)
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

    most = max(1, min(n_windows // 2, _distinct(samples)))
    if n_components == "bic":
        fit = _least_bic(fitted, n_windows, rank, most)
    elif n_components == "automatic":
        count = np.clip(n_windows // _WINDOWS_EACH, _LEAST_COMPONENTS, MOST_COMPONENTS)
        fit = fitted(min(int(count), most))
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
    centred: NDArray[np.float64], explained_variance: float
) -> tuple[NDArray[np.float64], float]:
    """Return the leading directions (r, n) of rows (N, n), and what they leave out.

    That is the mean variance in the n - r other directions.
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
        # Of length sqrt(energy), and orthogonal only as far as that is not tiny.
        leading = np.linalg.qr(centred.T @ leading)[0]
    return np.ascontiguousarray(leading.T), residual


def _rank(
    energy: NDArray[np.float64], n: int, explained_variance: float
) -> tuple[int, float]:
    """Return how many directions to keep, and the mean variance in the others."""
    total = float(energy.sum())
    if total < 1 / GREATEST:
        return 1, total / n
    kept = np.cumsum(energy) / total
    rank = 1 + int(np.searchsorted(kept, explained_variance * (1 - 1e-12)))
    rank = min(rank, len(energy))
    return rank, float(energy[rank:].sum()) / max(n - rank, 1)


def _distinct(samples: NDArray[np.float64]) -> int:
    """Return how many samples differ by more than rounding."""
    greatest = float(np.max(np.abs(samples)))
    if greatest**2 < 1 / GREATEST:
        return 1
    return len(np.unique(np.round(samples / greatest, 9), axis=0))


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
