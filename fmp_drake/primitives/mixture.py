"""Gaussian mixture over Fourier weights, fitted in the span of the data."""

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from fmp_drake.errors import SkillError
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian


def fit_mixture(
    weights: NDArray[np.float64],
    *,
    n_components: int,
    explained_variance: float,
    regularization: float,
    seed: int,
) -> tuple[NDArray[np.float64], tuple[LowRankGaussian, ...]]:
    """Fit the mixture (9) by EM, initialised by k-means.

    There are far fewer windows than weights, so EM runs on the coordinates of the
    windows in their leading principal directions. What those leave out, and
    the regulariser, is an isotropic variance in all directions.

    Parameters
    ----------
    weights : ndarray, shape (N, n)
        One row of Fourier weights per window.
    n_components : int
        M; at most half the number of windows are used.
    explained_variance : float
        Share of the variance that the principal directions keep, in (0, 1].
    regularization : float
        Variance added in every direction, in squared units of the weights.
    seed : int
        Of the k-means initialisation.

    Returns
    -------
    proportions : ndarray, shape (M,)
        The pi_j.
    components : tuple of LowRankGaussian
        M Gaussians over the n weights, sorted by falling proportion.
    """
    n_windows, n = weights.shape
    mean = weights.mean(axis=0)
    centred = weights - mean
    _, singular, directions = np.linalg.svd(centred, full_matrices=False)
    energy = np.cumsum(singular**2)
    if energy[-1] <= 0:
        rank = 1
        residual = 0.0
    else:
        rank = 1 + int(np.searchsorted(energy / energy[-1], explained_variance))
        rank = min(rank, len(singular))
        residual = (energy[-1] - energy[rank - 1]) / n_windows / max(n - rank, 1)
    directions = directions[:rank]
    noise = float(regularization + residual)
    m = max(1, min(n_components, n_windows // 2))
    model = GaussianMixture(
        n_components=m,
        covariance_type="full",
        reg_covar=noise,
        init_params="kmeans",
        random_state=seed,
    )
    with warnings.catch_warnings():
        # k-means says so when windows coincide; EM is cut off at 100 rounds.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(centred @ directions.T)
    components = []
    order = np.argsort(-model.weights_, kind="stable")
    for j in order:
        variances, rotation = np.linalg.eigh(
            model.covariances_[j] - noise * np.eye(rank)
        )
        keep = variances > 1e-6 * noise
        components.append(
            LowRankGaussian(
                mean=mean + model.means_[j] @ directions,
                basis=np.ascontiguousarray(directions.T @ rotation[:, keep]),
                variances=np.ascontiguousarray(variances[keep]),
                noise=noise,
            )
        )
    return model.weights_[order].copy(), tuple(components)


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
