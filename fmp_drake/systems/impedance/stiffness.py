"""Stiffness that varies: from a covariance, from a port, smooth in time."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class CovarianceStiffnessConfig:
    """Minimal intervention: stiff where the demonstrations agree, loose elsewhere.

    Attributes
    ----------
    enabled : bool
        Whether the port `covariance` is used.
    min_stiffness, max_stiffness : float
        Bounds of every eigenvalue, N/m.
    deviation : float
        Standard deviation at which the stiffness is midway between its bounds, m.
    axes : list of 3 bools
        Which of T's axes are concerned; the others keep their stiffness. By default
        not the normal, along which the force, not the position, is to be held.
    """

    enabled: bool = False
    min_stiffness: float = 300.0
    max_stiffness: float = 1500.0
    deviation: float = 0.02
    axes: list[bool] = field(default_factory=lambda: [True, True, False])


def stiffness_from_covariance(
    config: CovarianceStiffnessConfig, covariance: Array, stiffness: Array
) -> Array:
    """Turn the covariance of the desired position into a stiffness.

    ``K = k_min I + (k_max − k_min) (I + Σ / σ²)⁻¹``: between the bounds it falls as
    the precision ``Σ⁻¹`` of the minimal-intervention principle; it has Σ's
    axes; it is smooth in Σ; and ``k_min I ≤ K ≤ k_max I`` for every covariance.

    Parameters
    ----------
    config : CovarianceStiffnessConfig
    covariance : array, shape (3, 3)
        Σ of the desired p_TE, in T, m². Positive semidefinite.
    stiffness : array, shape (6, 6)
        Of what does not follow the covariance, in T.

    Returns
    -------
    array, shape (6, 6)
        K, in T.

    References
    ----------
    .. [1] S. Calinon, D. Bruno, D. G. Caldwell, "A task-parameterized probabilistic
       model with minimal intervention control", ICRA 2014.
    """
    chosen = np.flatnonzero(config.axes)
    block = np.ix_(chosen, chosen)
    identity = np.eye(len(chosen))
    share = np.linalg.inv(identity + covariance[block] / config.deviation**2)
    share = 0.5 * (share + share.T)
    span = config.max_stiffness - config.min_stiffness
    K = stiffness.copy()
    rows = chosen + 3
    K[rows, :] = 0.0
    K[:, rows] = 0.0
    K[np.ix_(rows, rows)] = config.min_stiffness * identity + span * share
    return K


def is_covariance(covariance: Array) -> bool:
    """Tell whether a matrix is symmetric and positive semidefinite, up to rounding."""
    size = float(np.abs(covariance).max())
    if not np.abs(covariance - covariance.T).max() <= 1e-6 * size:
        return False
    return is_spring(covariance + 1e-6 * max(size, 1e-12) * np.eye(len(covariance)))


def is_spring(stiffness: Array) -> bool:
    """Tell whether a matrix is symmetric, positive definite and finite."""
    size = float(np.abs(stiffness).max())
    if not np.abs(stiffness - stiffness.T).max() <= 1e-6 * size:
        return False
    _, info = lapack.dpotrf(stiffness, lower=1)
    return bool(info == 0)


def spring_of(values: Array) -> Array | None:
    """Return the stiffness that a port's vector means, or None if it is no spring.

    Parameters
    ----------
    values : array, shape (6,) or (36,)
        The diagonal, or all rows, of K: rotations first, Nm/rad and N/m.

    Returns
    -------
    array, shape (6, 6), or None
    """
    if values.size == 6:
        return np.diag(values) if min(values.tolist()) > 0 else None
    K = values.reshape(6, 6)
    return 0.5 * (K + K.T) if is_spring(K) else None
