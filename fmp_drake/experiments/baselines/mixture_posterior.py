"""A Gaussian mixture given a linear observation."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp


class MixturePosterior(NamedTuple):
    """The posterior of a mixture of M Gaussians in n dimensions.

    Attributes
    ----------
    log_evidence : float
        Log density of the observation under the mixture.
    probabilities : ndarray, shape (M,)
        Of the components, given the observation.
    means : ndarray, shape (M, n)
        Of the components, given the observation.
    """

    log_evidence: float
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
    values : ndarray, shape (m,)
    noise : array_like, shape () or (m,)
        Variance of each observation's noise, positive.
    """
    m = len(values)
    log_joint = np.log(proportions)
    new_means = np.empty_like(means)
    for j, (mean, covariance) in enumerate(zip(means, covariances, strict=True)):
        cross = rows @ covariance
        observed = cross @ rows.T
        observed[np.diag_indices(m)] += noise
        factor = cho_factor(observed, lower=True)
        error = values - rows @ mean
        solved = cho_solve(factor, error)
        new_means[j] = mean + cross.T @ solved
        log_joint[j] -= 0.5 * (error @ solved + m * np.log(2 * np.pi))
        log_joint[j] -= np.sum(np.log(np.diag(factor[0])))
    total = float(logsumexp(log_joint))
    return MixturePosterior(total, np.exp(log_joint - total), new_means)
