"""A Gaussian mixture given a linear observation."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp


class MixturePosterior(NamedTuple):
    """The posterior of a mixture of M Gaussians in n dimensions.

    Leading axes (...) are those of the observations.

    Attributes
    ----------
    log_evidence : ndarray, shape (...)
        Log density of the observation under the mixture.
    probabilities : ndarray, shape (M, ...)
        Of the components, given the observation.
    means : ndarray, shape (M, ..., n)
        Of the components, given the observation.
    """

    log_evidence: NDArray[np.float64]
    probabilities: NDArray[np.float64]
    means: NDArray[np.float64]


def condition_mixture(
    proportions: NDArray[np.float64],
    means: NDArray[np.float64],
    covariances: NDArray[np.float64],
    *,
    rows: NDArray[np.float64],
    values: NDArray[np.float64],
    noise: ArrayLike,
) -> MixturePosterior:
    """Condition a mixture (M,), (M, n), (M, n, n) on rows @ w = values + noise.

    Every component is conditioned as Paraschos et al. (2018) do with their one
    Gaussian; the probabilities of the components follow from Bayes' rule.

    Parameters
    ----------
    rows : ndarray, shape (m, n)
    values : ndarray, shape (..., m)
        One observation, or several that are each conditioned on alone.
    noise : array_like, shape () or (m,)
        Variance of each observation's noise, positive.
    """
    m = len(rows)
    posteriors, log_joint = [], []
    for proportion, mean, covariance in zip(
        proportions, means, covariances, strict=True
    ):
        cross = rows @ covariance
        observed = cross @ rows.T
        observed[np.diag_indices(m)] += noise
        factor = cho_factor(observed, lower=True)
        error = values - rows @ mean
        solved = cho_solve(factor, error.T).T
        posteriors.append(mean + solved @ cross)
        log_root = np.sum(np.log(np.diag(factor[0])))
        squares = np.sum(error * solved, axis=-1) + m * np.log(2 * np.pi)
        log_joint.append(np.log(proportion) - 0.5 * squares - log_root)
    total = logsumexp(log_joint, axis=0)
    return MixturePosterior(total, np.exp(log_joint - total), np.stack(posteriors))
