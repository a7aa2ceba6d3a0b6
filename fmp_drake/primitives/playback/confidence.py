"""Weights that stay within what a component has seen."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian


def confined(
    gaussian: LowRankGaussian, weights: NDArray[np.float64], confidence: float
) -> NDArray[np.float64]:
    """Return weights projected on a component's span and into its ellipsoid.

    Parameters
    ----------
    gaussian : LowRankGaussian
        The component.
    weights : ndarray, shape (n,)
    confidence : float
        Fraction of the component's own samples inside the ellipsoid, in (0, 1].
    """
    inside = (weights - gaussian.mean) @ gaussian.basis
    spread = np.sqrt(gaussian.variances + gaussian.noise)
    squared = float(np.sum((inside / spread) ** 2))
    radius_squared = float(chi2.ppf(confidence, max(gaussian.rank, 1)))
    inside *= np.sqrt(min(1.0, radius_squared / max(squared, 1e-24)))
    out: NDArray[np.float64] = gaussian.mean + gaussian.basis @ inside
    return out
