"""Gaussian mixtures given linear observations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp


@dataclass(frozen=True, kw_only=True, eq=False)
class MixturePosterior:
    """A mixture of M Gaussians in n dimensions, given m observed numbers.

    Attributes
    ----------
    log_evidence : float
        Of the observation, under the mixture.
    responsibilities : ndarray, shape (M,)
    means : ndarray, shape (M, n)
    covariances : ndarray, shape (M, n, n)
        Prior ones.
    whitened : ndarray, shape (M, m, n)
        L^-1 Phi Sigma_j, where L L' is the covariance of the observation.
    """

    log_evidence: float
    responsibilities: NDArray[np.float64]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]
    whitened: NDArray[np.float64]

    def covariance(self, component: int) -> NDArray[np.float64]:
        """Return the posterior covariance of a component, shape (n, n)."""
        z = self.whitened[component]
        out: NDArray[np.float64] = self.covariances[component] - z.T @ z
        return out

    def mean(self) -> NDArray[np.float64]:
        """Return the posterior mean of the mixture, shape (n,)."""
        out: NDArray[np.float64] = self.responsibilities @ self.means
        return out


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
    Gaussian; the responsibilities are those of Bayes' rule.

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
    whitened = np.empty((len(means), m, means.shape[1]))
    for j, (mean, covariance) in enumerate(zip(means, covariances, strict=True)):
        cross = rows @ covariance
        observed = cross @ rows.T
        observed[np.diag_indices(m)] += noise
        lower = cholesky(observed, lower=True)
        whitened[j] = solve_triangular(lower, cross, lower=True)
        z = solve_triangular(lower, values - rows @ mean, lower=True)
        new_means[j] = mean + whitened[j].T @ z
        log_joint[j] -= 0.5 * (z @ z + m * np.log(2 * np.pi))
        log_joint[j] -= np.sum(np.log(np.diag(lower)))
    total = float(logsumexp(log_joint))
    return MixturePosterior(
        log_evidence=total,
        responsibilities=np.exp(log_joint - total),
        means=new_means,
        covariances=covariances,
        whitened=whitened,
    )
